#define _GNU_SOURCE
#include <math.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/resource.h>
#include <time.h>
#include "arm.h"

void *__libc_malloc(size_t);
void *__libc_calloc(size_t, size_t);
void *__libc_realloc(void *, size_t);
static long count;
void *malloc(size_t n) { count++; return __libc_malloc(n); }
void *calloc(size_t n, size_t m) { count++; return __libc_calloc(n, m); }
void *realloc(void *p, size_t n) { count++; return __libc_realloc(p, n); }

enum { MOST = 1000000 };
static double wall[MOST], spent[MOST];

static double now(clockid_t which)
{
    struct timespec t;
    clock_gettime(which, &t);
    return 1e6 * t.tv_sec + 1e-3 * t.tv_nsec;
}

static int larger(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

int main(int argc, char **argv)
{
    const int n = atoi(argv[1]);
    const struct sched_param first = {.sched_priority = 10};
    const int urgent = argc > 2 && sched_setscheduler(0, SCHED_FIFO, &first) == 0;
    arm_arm *arm = arm_create();
    double action[ARM_JOINTS];
    struct rusage use;
    long before = 0, faults = 0, ended = 0;
    for (int k = 0; k < MOST; k++) wall[k] = spent[k] = 0.0;
    for (int k = -1000, over = 1; k < n; k++) { /* what comes first warms up */
        if (over || k % 500 == 0) arm_reset(arm, k + 1000, NULL, NULL, NAN);
        if (k == 0) {
            before = count;
            getrusage(RUSAGE_SELF, &use);
            faults = use.ru_minflt + use.ru_majflt;
        }
        for (int i = 0; i < ARM_JOINTS; i++) action[i] = 0.3 * sin(2.0 * k * ARM_PERIOD + i);
        const double c = now(CLOCK_THREAD_CPUTIME_ID), t = now(CLOCK_MONOTONIC);
        over = arm_step(arm, action) != ARM_OK;
        const double later = now(CLOCK_MONOTONIC) - t, more = now(CLOCK_THREAD_CPUTIME_ID) - c;
        if (k >= 0) wall[k] = later, spent[k] = more, ended += over;
    }
    const long calls = count - before;
    getrusage(RUSAGE_SELF, &use);
    faults = use.ru_minflt + use.ru_majflt - faults;
    qsort(wall, n, sizeof(double), larger);
    qsort(spent, n, sizeof(double), larger);
    printf("{\"urgent\": %d, \"allocations\": %ld, \"faults\": %ld, \"ended\": %ld, ", urgent, calls, faults, ended);
    printf("\"wall\": [%.3f, %.3f, %.3f], ", wall[n / 2], wall[n - 1 - n / 1000], wall[n - 1]);
    printf("\"spent\": [%.3f, %.3f, %.3f]}\n", spent[n / 2], spent[n - 1 - n / 1000], spent[n - 1]);
    arm_destroy(arm);
    return 0;
}
