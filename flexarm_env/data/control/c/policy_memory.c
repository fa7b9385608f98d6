typedef struct {
    float seen[UPPER_OBSERVATION];
    int begun;
} NAME_memory;
