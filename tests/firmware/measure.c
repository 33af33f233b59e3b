/*
 * Prints the instructions of one step, the bytes of the state, and the bytes of stack.
 * CONTROLLER is the prefix of the exported functions.
 *
 * QEMU with -icount shift=0 spends 1 ns per instruction; SysTick counts at 25 MHz, so a tick is
 * 40 instructions. What the loop itself takes is measured with a function that does nothing.
 */

#include <stdint.h>
#include <stdio.h>

#define JOIN(a, b) a##b
#define NAME(prefix, end) JOIN(prefix, end)
#define TEXT(a) #a
#define EXPANDED(a) TEXT(a)
#ifdef MONITORED /* measures what monitored.c calls */
#include EXPANDED(NAME(CONTROLLER, _monitor).h)
#else
#include EXPANDED(CONTROLLER.h)
#endif

#define STATES NAME(CONTROLLER, _STATES)
#define REFERENCES NAME(CONTROLLER, _REFERENCES)
#define STEPS 1000u
#define PAINTED 4096u
#define PAINT 0xA5u

typedef NAME(CONTROLLER, _real) real;
#ifdef MONITORED
typedef NAME(CONTROLLER, _monitor) state;
#define INIT NAME(CONTROLLER, _monitor_init)
#define STEP monitored
real monitored(state *s, const real x[], const real y_d[]);
#else
typedef NAME(CONTROLLER, _state) state;
#define INIT NAME(CONTROLLER, _init)
#define STEP NAME(CONTROLLER, _step)
#endif
typedef real step(state *s, const real x[], const real y_d[]);

#define SYST_CSR (*(volatile uint32_t *)0xE000E010u)
#define SYST_RVR (*(volatile uint32_t *)0xE000E014u)
#define SYST_CVR (*(volatile uint32_t *)0xE000E018u)

static real x[STEPS][STATES], y_d[REFERENCES];

__attribute__((noinline)) static real nothing(state *s, const real x0[], const real y0[])
{
    __asm volatile("" : : "r"(s), "r"(x0), "r"(y0));
    return 0;
}

__attribute__((noinline)) static uint32_t ticks(step *function)
{
    state s;
    uint32_t begin;

    INIT(&s);
    begin = SYST_CVR;
    for (uint32_t k = 0; k < STEPS; k++) {
        (void)function(&s, x[k], y_d);
    }
    return (begin - SYST_CVR) & 0xFFFFFFu;
}

/* Bytes of the stack that some steps have written to, the functions of libm included. */
__attribute__((noinline)) static uint32_t stack(step *function)
{
    static state s;
    volatile uint8_t *lowest;
    uint32_t untouched = 0;

    __asm volatile("mov %0, sp" : "=r"(lowest));
    lowest -= PAINTED;
    INIT(&s);
    for (uint32_t i = 0; i < PAINTED; i++) {
        lowest[i] = PAINT;
    }
    for (uint32_t k = 0; k < 100u; k++) {
        (void)function(&s, x[k], y_d);
    }
    while (untouched < PAINTED && lowest[untouched] == PAINT) {
        untouched++;
    }
    return PAINTED - untouched;
}

int main(void)
{
    /* triangles of amplitude 2: smooth enough to be differenced */
    for (uint32_t k = 0; k < STEPS; k++) {
        for (uint32_t i = 0; i < STATES; i++) {
            const real phase = (real)((k + i * 300u) % STEPS) / (real)STEPS;

            x[k][i] = (phase < (real)0.5) ? ((real)8 * phase) - (real)2 : (real)6 - ((real)8 * phase);
        }
    }
    SYST_RVR = 0xFFFFFFu;
    SYST_CVR = 0;
    SYST_CSR = 5; /* on, processor clock */
    const uint32_t loop = ticks(nothing);
    const uint32_t all = ticks(STEP);
    printf("%u %u %u\n", (unsigned)((all - loop) * 40u / STEPS), (unsigned)sizeof(state),
        (unsigned)stack(STEP));
    return 0;
}
