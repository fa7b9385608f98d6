typedef struct {
FIELDS    double goal[UPPER_JOINTS], angle[UPPER_JOINTS]; /* of the joints, rad */
    long step;
    int begun, posture;
} NAME_memory;
