/* The arm under a torque that swings: cc example.c -I. -L. -lNAME -Wl,-rpath,. && ./a.out */
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
        const NAME_info *info = NAME_get_info(arm);
        if (k % 10 == 9) printf("%6.3f s  tip %9.6f %9.6f m\n", NAME_get_time(arm), info->tip[0], info->tip[1]);
    }
    printf("%s\n", NAME_status(status));
    NAME_destroy(arm);
    return status != UPPER_OK;
}
