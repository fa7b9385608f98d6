void NAME_reset(NAME_memory *memory)
{
    memory->begun = 0;
}

void NAME_act(NAME_memory *memory, const double measured[UPPER_ENTRIES], BESIDE_ARGUMENTfloat action[UPPER_JOINTS])
{
    double to_go[UPPER_JOINTS], torque[UPPER_JOINTS];
    const int first = !memory->begun;
    for (int i = 0; i < UPPER_JOINTS; i++) action[i] = 0.0f;
    for (int i = 0; i < UPPER_ENTRIES; i++)
        if (!(fabs(measured[i]) <= 1e30)) return; /* not finite: no torque, and what is remembered stays */
    if (first) {
        memory->begun = 1;
        memory->step = 0;
        NAME_aim(memory, measured);
        memory->posture = NAME_nearest(memory->goal);
    }
    NAME_to_go(memory, measured, to_go);
    if (first) NAME_begin(memory, measured, to_go);
    NAME_torques(memory, measured, to_go, torque);
    for (int i = 0; i < UPPER_JOINTS; i++) {
BESIDE_ADDED        if (torque[i] > NAME_limit[i]) torque[i] = NAME_limit[i];
        if (torque[i] < -NAME_limit[i]) torque[i] = -NAME_limit[i];
        action[i] = (float)(torque[i] / NAME_limit[i]);
    }
    NAME_predict(memory, torque);
    memory->step++;
}

void NAME_decide(NAME_memory *memory, const float observation[UPPER_HISTORY * UPPER_ENTRIES],
                 BESIDE_ARGUMENTfloat action[UPPER_JOINTS])
{
    double measured[UPPER_ENTRIES];
    for (int i = 0; i < UPPER_ENTRIES; i++)
        measured[i] = (double)observation[(UPPER_HISTORY - 1) * UPPER_ENTRIES + i] * NAME_scale[i];
    NAME_act(memory, measured, BESIDE_VALUEaction);
}
