void NAME_reset(NAME_memory *memory)
{
    memory->begun = 0;
}

void NAME_act(NAME_memory *memory, const float measured[UPPER_ENTRIES], float action[UPPER_ACTIONS])
{
    int i;
    for (i = 0; i < UPPER_ACTIONS; i++) action[i] = 0.0f;
    for (i = 0; i < UPPER_ENTRIES; i++)
        if (!(fabsf(measured[i]) <= 1e30f)) return; /* not finite: no torque, and what is remembered stays */
    for (i = 0; i < UPPER_OBSERVATION; i++) {
        const int next = i + UPPER_ENTRIES, k = i % UPPER_ENTRIES;
        if (memory->begun && next < UPPER_OBSERVATION)
            memory->seen[i] = memory->seen[next];
        else
            memory->seen[i] = NAME_bounded(measured[k] / NAME_scale[k], UPPER_MOST);
    }
    memory->begun = 1;
    NAME_decide(memory->seen, action);
}
