void NAME_reset(NAME_memory *memory)
{
    memory->begun = 0;
}

void NAME_act(NAME_memory *memory, const float measured[UPPER_ENTRIES], float action[UPPER_ACTIONS])
{
    int i;
    for (i = 0; i < UPPER_OBSERVATION; i++) {
        const int next = i + UPPER_ENTRIES, k = i % UPPER_ENTRIES;
        if (memory->begun && next < UPPER_OBSERVATION)
            memory->seen[i] = memory->seen[next];
        else {
            const float x = measured[k] / NAME_scale[k];
            memory->seen[i] = x < -UPPER_MOST ? -UPPER_MOST : x > UPPER_MOST ? UPPER_MOST : x;
        }
    }
    memory->begun = 1;
    NAME_decide(memory->seen, action);
}
