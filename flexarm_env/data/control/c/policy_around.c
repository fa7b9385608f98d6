typedef struct {
    NAME_network_memory network;
    NAME_inside_memory inside;
} NAME_memory;

void NAME_reset(NAME_memory *memory)
{
    NAME_network_reset(&memory->network);
    NAME_inside_reset(&memory->inside);
}

void NAME_act(NAME_memory *memory, const float measured[UPPER_NETWORK_ENTRIES], float action[UPPER_NETWORK_ACTIONS])
{
    double values[UPPER_NETWORK_ENTRIES], beside[UPPER_NETWORK_ACTIONS];
    int i;
    NAME_network_act(&memory->network, measured, action);
    for (i = 0; i < UPPER_NETWORK_ENTRIES; i++) values[i] = (double)measured[i];
    for (i = 0; i < UPPER_NETWORK_ACTIONS; i++) beside[i] = SHARE * (double)action[i];
    NAME_inside_act(&memory->inside, values, beside, action);
}

void NAME_decide(NAME_memory *memory, const float observation[UPPER_NETWORK_OBSERVATION],
                 float action[UPPER_NETWORK_ACTIONS])
{
    double beside[UPPER_NETWORK_ACTIONS];
    int i;
    NAME_network_decide(observation, action);
    for (i = 0; i < UPPER_NETWORK_ACTIONS; i++) beside[i] = SHARE * (double)action[i];
    NAME_inside_decide(&memory->inside, observation, beside, action);
}
