#include "machine.h"

#include "gap8.h"
#include "stm32.h"

const machine_t *machine_of(int mcu) {
    static const machine_t *const MACHINES[] = {&stm32_machine, &gap8_machine};
    return mcu >= 0 && mcu < (int)(sizeof MACHINES / sizeof MACHINES[0]) ? MACHINES[mcu] : NULL;
}
