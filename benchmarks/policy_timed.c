#include <stdio.h>
#include <time.h>
#include "policy.c"
int main(void)
{
    float seen[SIZE] = {0.1f}, action[4], total = 0.0f;
    double best = 1.0;
    int i, round;
    for (round = 0; round < 50; round++) {
        const clock_t began = clock();
        for (i = 0; i < 200; i++) {
            seen[0] += 1e-4f;
            policy_decide(seen, action);
            total += action[0];
        }
        const double each = (double)(clock() - began) / CLOCKS_PER_SEC / 200.0;
        best = each < best ? each : best;
    }
    printf("%g", total > 1e9f ? 1.0 : best);
    return 0;
}
