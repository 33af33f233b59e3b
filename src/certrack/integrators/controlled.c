/* Members of a system under held controls, and the slopes of what they end with.
 *
 * The classical Runge-Kutta method with the same steps for the members in all lanes; backwards, its
 * exact derivative (the discrete adjoint). `system.h` is generated: sizes STATES CONTROLS
 * PARAMETERS, and
 *   rates(x, c, p, k)             k = x'
 *   pullback(x, c, p, g, ox, oc, op)   g' times the derivatives of x' by x, c and p
 */
#include "vector_math.h"
#include "system.h"

typedef struct {
  int64_t steps;
  const double *widths; /* steps */
  const double *starts, *controls, *parameters; /* S, steps x C and P rows of LANES */
  double *states; /* (steps + 1) x S rows */
  const double *costate; /* S rows: the slopes of the output by the states at the end; or NULL */
  double *by_start, *by_controls, *by_parameters; /* slopes, of the shapes of the inputs */
} Task;

INLINE void load(const double *from, V *to, int rows) { memcpy(to, from, rows * sizeof(V)); }
INLINE void store(const V *from, double *to, int rows) { memcpy(to, from, rows * sizeof(V)); }

/* The states at the four stages of a step, and the slopes there. */
static void stages(V h, V x[4][STATES], V k[4][STATES], const V *c, const V *p) {
  for (int i = 0; i < 4; i++) {
    V part = i == 3 ? h : 0.5 * h;
    if (i)
      for (int j = 0; j < STATES; j++) x[i][j] = x[0][j] + part * k[i - 1][j];
    rates(x[i], c, p, k[i]);
  }
}

static void forward(const Task *task, const V *p) {
  V x[4][STATES], k[4][STATES], c[CONTROLS + 1];
  load(task->starts, x[0], STATES);
  store(x[0], task->states, STATES);
  for (int64_t n = 0; n < task->steps; n++) {
    V h = SPLAT(task->widths[n]);
    load(task->controls + n * CONTROLS * LANES, c, CONTROLS);
    stages(h, x, k, c, p);
    for (int j = 0; j < STATES; j++)
      x[0][j] += h * (1.0 / 6) * (k[0][j] + 2.0 * (k[1][j] + k[2][j]) + k[3][j]);
    store(x[0], task->states + (n + 1) * STATES * LANES, STATES);
  }
}

static void backward(const Task *task, const V *p) {
  V x[4][STATES], k[4][STATES], c[CONTROLS + 1], l[STATES], g[STATES], back[STATES];
  V of_c[CONTROLS + 1], of_p[PARAMETERS + 1], sum_c[CONTROLS + 1], sum_p[PARAMETERS + 1];
  for (int j = 0; j < PARAMETERS; j++) sum_p[j] = SPLAT(0.0);
  load(task->costate, l, STATES);
  for (int64_t n = task->steps - 1; n >= 0; n--) {
    V h = SPLAT(task->widths[n]), by_x[STATES];
    load(task->states + n * STATES * LANES, x[0], STATES);
    load(task->controls + n * CONTROLS * LANES, c, CONTROLS);
    stages(h, x, k, c, p);
    for (int j = 0; j < STATES; j++) by_x[j] = l[j], back[j] = SPLAT(0.0);
    for (int j = 0; j < CONTROLS; j++) sum_c[j] = SPLAT(0.0);
    for (int i = 3; i >= 0; i--) {
      V weight = h * (i == 0 || i == 3 ? 1.0 / 6 : 1.0 / 3), part = i == 2 ? h : 0.5 * h;
      for (int j = 0; j < STATES; j++) g[j] = weight * l[j] + (i == 3 ? 0.0 * h : part) * back[j];
      pullback(x[i], c, p, g, back, of_c, of_p);
      for (int j = 0; j < STATES; j++) by_x[j] += back[j];
      for (int j = 0; j < CONTROLS; j++) sum_c[j] += of_c[j];
      for (int j = 0; j < PARAMETERS; j++) sum_p[j] += of_p[j];
    }
    for (int j = 0; j < STATES; j++) l[j] = by_x[j];
    store(sum_c, task->by_controls + n * CONTROLS * LANES, CONTROLS);
  }
  store(l, task->by_start, STATES);
  store(sum_p, task->by_parameters, PARAMETERS);
}

/* Forward, and backward where slopes are asked for. */
int integrate(const Task *task) {
  V p[PARAMETERS + 1];
  load(task->parameters, p, PARAMETERS);
  forward(task, p);
  if (task->costate) backward(task, p);
  return 0;
}
