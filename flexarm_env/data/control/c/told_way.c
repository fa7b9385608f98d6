    for (int i = 0; i < 3; i++) {
        target[i] = p.tip[i];
        for (int j = 0; j < 3; j++) target[i] += p.link[0][3 * i + j] * v[NAME_errors[j]];
    }
