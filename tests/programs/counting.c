#include <math.h>
#include <stdio.h>
#include "arm.h"

void *__libc_malloc(size_t);
void *__libc_calloc(size_t, size_t);
void *__libc_realloc(void *, size_t);
static long count;
void *malloc(size_t n) { count++; return __libc_malloc(n); }
void *calloc(size_t n, size_t m) { count++; return __libc_calloc(n, m); }
void *realloc(void *p, size_t n) { count++; return __libc_realloc(p, n); }

int main(void)
{
    arm_arm *arm = arm_create();
    const long before = count;
    double action[ARM_JOINTS];
    for (int k = 0; k < 2000; k++) {
        for (int i = 0; i < ARM_JOINTS; i++) action[i] = 0.3 * sin(0.04 * k + i);
        if (k == 0 || arm_step(arm, action)) arm_reset(arm, k, NULL, NULL, NAN);
    }
#ifdef ARM_STATES
    double x[ARM_STATES], y[ARM_OBSERVATION], r, xb[ARM_STATES];
    arm_get_states(arm, x);
    arm_jvp(arm, x, action, x, action, x, y, &r);
    arm_vjp(arm, x, action, x, y, r, xb, action);
#endif
    const long after = count;
    printf("%ld %ld\n", before, after - before);
    arm_destroy(arm);
    return 0;
}
