#include "machine.h"

const machine_t *machine_of(int mcu) {
    static const machine_t *const MACHINES[] = {NULL, NULL};
    return mcu >= 0 && mcu < 2 ? MACHINES[mcu] : NULL;
}
