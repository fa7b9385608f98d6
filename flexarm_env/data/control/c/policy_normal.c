/* entry i of an observation less its mean, over its deviation, clipped */
static float NAME_normal(int i, float value, float *rest)
{
    const float d = value - NAME_mean[i], back = value - d;
    const float d_rest = ((value - (d + back)) + (back - NAME_mean[i])) - NAME_mean_rest[i];
    const float s = NAME_inverse[i], x = d * s;
    const float wide = d * 4097.0f, head = wide - (wide - d), tail = d - head;
    const float large = s * 4097.0f, first = large - (large - s), last = s - first;
    *rest = (((head * first - x) + head * last) + tail * first) + tail * last;
    *rest += d * NAME_inverse_rest[i] + d_rest * s;
    if (x >= -NAME_clip && x <= NAME_clip)
        return x;
    *rest = 0.0f;
    return x < 0.0f ? -NAME_clip : NAME_clip;
}
