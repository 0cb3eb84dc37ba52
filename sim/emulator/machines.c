#include "machine.h"

#include "stm32.h"

const machine_t *machine_of(int mcu) {
    static const machine_t *const MACHINES[] = {&stm32_machine};
    return mcu == 0 ? MACHINES[0] : NULL;
}
