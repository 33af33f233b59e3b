/* Start of a Cortex-M4F under QEMU; what is printed and the exit code go out by semihosting. */

#include <stdint.h>
#include <stdlib.h>

extern uint32_t stack_top;
extern int main(void);
extern void initialise_monitor_handles(void);
extern void _exit(int code);

/* newlib asks for them */
void _init(void);
void _fini(void);
void _init(void) {}
void _fini(void) {}

static void reset(void)
{
    *(volatile uint32_t *)0xE000ED88u |= 0xFu << 20; /* CPACR: floating point unit on */
    __asm volatile("dsb\nisb");
    initialise_monitor_handles();
    exit(main());
}

static void fault(void)
{
    _exit(99);
}

__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {
    &stack_top, (void *)reset, (void *)fault, (void *)fault, (void *)fault, (void *)fault,
    (void *)fault};
