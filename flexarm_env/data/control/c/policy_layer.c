/* out + out_rest = (in + in_rest) w + b; 4097 cuts a float in two of 12 digits, whose product is exact */
static void NAME_layer(const float *in, const float *in_rest, int rows, const float *w, const float *b, float *out,
                       float *out_rest, int columns)
{
    int j, k;
    for (j = 0; j < columns; j++) {
        out[j] = b[j];
        out_rest[j] = 0.0f;
    }
    for (k = 0; k < rows; k++, w += columns) {
        register const float wide = in[k] * 4097.0f;
        register const float head = wide - (wide - in[k]), tail = (in[k] - head) + in_rest[k];
        for (j = 0; j < columns; j++) {
            register const float large = w[j] * 4097.0f, first = large - (large - w[j]), term = head * first;
            register const float before = out[j], sum = before + term, back = sum - before;
            out_rest[j] += ((before - (sum - back)) + (term - back)) + (head * (w[j] - first) + tail * w[j]);
            out[j] = sum;
        }
    }
}
