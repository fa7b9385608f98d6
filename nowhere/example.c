/* The arm under a torque that swings: cc example.c -I. -L. -larm -Wl,-rpath,. && ./a.out */
#include "arm.h"

#include <math.h>
#include <stdio.h>

int main(void)
{
    arm_arm *arm = arm_create();
    if (arm == NULL) return 1;
    int status = arm_reset(arm, 1, NULL, NULL, NAN);
    for (int k = 0; k < 100 && status == ARM_OK; k++) {
        double action[ARM_JOINTS];
        for (int i = 0; i < ARM_JOINTS; i++) action[i] = 0.3 * sin(2.0 * arm_get_time(arm) + i);
        status = arm_step(arm, action);
        if (k % 10 != 9) continue;
        const arm_info *info = arm_get_info(arm);
        printf("%6.3f s  tip", arm_get_time(arm));
        for (size_t i = 0; i < sizeof(info->tip) / sizeof(double); i++) printf(" %9.6f", info->tip[i]);
        puts(" m");
    }
    printf("%s\n", arm_status(status));
    arm_destroy(arm);
    return status != ARM_OK;
}
