/*
 * What a drive calls every period of a controller with its monitor, as one function of its own:
 * for its size, and for measure.c.
 */

#define JOIN(a, b) a##b
#define NAME(prefix, end) JOIN(prefix, end)
#define TEXT(a) #a
#define EXPANDED(a) TEXT(a)
#include EXPANDED(NAME(CONTROLLER, _monitor).h)

typedef NAME(CONTROLLER, _real) real;
typedef NAME(CONTROLLER, _monitor) monitor;

real monitored(monitor *m, const real x[], const real y_d[]);

real monitored(monitor *m, const real x[], const real y_d[])
{
    return NAME(CONTROLLER, _monitored_step)(m, true, x, y_d);
}
