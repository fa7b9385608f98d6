/* The arm under a torque that swings: cc example.c -I. -L. -lNAME -Wl,-rpath,. -lm && ./a.out */
#include "NAME.h"

#include <math.h>
#include <stdio.h>

int main(void)
{
    NAME_arm *arm = NAME_create();
    if (arm == NULL) return 1;
    int status = NAME_reset(arm, 1, NULL, NULL, NAN);
    for (int k = 0; k < 100 && status == UPPER_OK; k++) {
        double action[UPPER_JOINTS];
        for (int i = 0; i < UPPER_JOINTS; i++) action[i] = 0.3 * sin(2.0 * NAME_get_time(arm) + i);
        status = NAME_step(arm, action);
        if (k % 10 != 9) continue;
        const NAME_info *info = NAME_get_info(arm);
        printf("%6.3f s  tip", NAME_get_time(arm));
        for (size_t i = 0; i < sizeof(info->tip) / sizeof(double); i++) printf(" %9.6f", info->tip[i]);
        puts(" m");
    }
    printf("%s\n", NAME_status(status));
    NAME_destroy(arm);
    return status != UPPER_OK;
}
