/* the value, no larger than `most` in size */
static float NAME_bounded(float value, float most) { return value < -most ? -most : value > most ? most : value; }
