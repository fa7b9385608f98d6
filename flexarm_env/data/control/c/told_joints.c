    double wanted[UPPER_JOINTS];
    for (int k = 0; k < UPPER_JOINTS; k++) wanted[k] = m->angle[k] + v[NAME_errors[k]];
    NAME_stand(wanted, &p);
    for (int i = 0; i < 3; i++) target[i] = p.tip[i];
