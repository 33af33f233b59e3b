/* One run of a plant under a sampled controller, with a record of its steps: run.py in C.
 *
 * `system.h` is generated, as for native.c. What needs more than arithmetic is left to run.py: this
 * stops where no step is accurate and where a state leaves the admitted ones.
 */
#include "scalar_math.h"
#include "system.h"
#ifdef PLANNED
#include "plan.h"
#endif

enum { NODES = 7, SIDES = 4, SAMPLE = 1, ACT = 2 };

/* A run, and how far it is. */
typedef struct {
  double *x, *k, *y; /* plant states, controller's states, totals; now */
  const double *parameters;
  int64_t events;
  const double *times;
  const double *clock; /* of samples as the controller knows them: without jitter */
  const uint8_t *kinds; /* SAMPLE, ACT */
  const int32_t *segments; /* which row of `shared` holds from an event on */
  const double *shared; /* segments x SHARED */
  double *waiting; /* `depth` commands that do not act yet */
  int64_t depth;
  const double *errors; /* of the sensors: samples x MEASURED, or none */
  const double *quantum; /* MEASURED */
  double input_quantum, input_low, input_high; /* of the converter */
  double tolerance, max_state;
  double *record; /* rows of `room`: end, x, y, u and sides of a step */
  int64_t room;
  double *estimates; /* rows of `most_samples`: the first controller's states before a sample */
  int64_t estimated, most_samples;
  double u; /* that acts */
  int64_t event, samples, commands, steps; /* so far */
#ifdef PLANNED
  Plan plan;
#endif
} Run;

/* A step from `t` on: what it starts from and what it leads to. */
typedef struct {
  double t, h, allowed;
  const double *s;
  double c[NODES][COMMON + 1]; /* what depends on time alone, at its nodes */
  double x[STATES], y[TOTALS], sides[SIDES]; /* e_1 at begin and end, e_1' there */
} Step;

/* A function of its own, for it is called at every node: compiled once, it is compiled sooner. */
OUTLINE void rates_at(const Run *run, const double *c, const double *x, double *k, double *e) {
  rates(c, x, run->u, run->parameters, k, e);
}

INLINE void common_at(const Step *step, double t, double *c) {
  if (COMMON) common(t, step->s, c);
}

INLINE double squared(double error, double allowed, double a, double b) {
  double ratio = error / (allowed * (1.0 + v_max(fabs(a), fabs(b))));
  return ratio * ratio;
}

/* The step from where the run is; returns its error over the allowed one, that of the integral of
 * e_1 among them: a reference may be faster than the plant. */
static double try_step(const Run *run, Step *step) {
  double k[NODES][STATES], e[NODES][2], h = step->h;
  for (int i = 1; i < NODES - 1; i++) common_at(step, step->t + h * C[i], step->c[i]);
  memcpy(step->c[NODES - 1], step->c[NODES - 2], sizeof step->c[0]); /* both are at the end */
  rates_at(run, step->c[0], run->x, k[0], e[0]);
  for (int i = 1; i < NODES; i++) {
    for (int j = 0; j < STATES; j++) {
      double sum = 0.0;
      for (int a = 0; a < i; a++) sum += A[i][a] * k[a][j];
      step->x[j] = run->x[j] + h * sum;
    }
    rates_at(run, step->c[i], step->x, k[i], e[i]);
  }
  double worst = 0.0, missed = 0.0, sums[2] = {0.0, 0.0};
  for (int j = 0; j < STATES; j++) {
    double error = 0.0;
    for (int i = 0; i < NODES; i++) error += E[i] * k[i][j];
    worst += squared(error * h, step->allowed, run->x[j], step->x[j]);
  }
  for (int i = 0; i < NODES; i++) missed += E[i] * e[i][0];
  worst += squared(missed * h, step->allowed, e[0][0], e[NODES - 1][0]);
  for (int i = 0; i < NODES - 1; i++) {
    sums[0] += B[i] * e[i][0] * e[i][0];
    sums[1] += B[i] * e[i][0];
  }
  sums[0] *= h;
  sums[1] *= h;
  for (int i = 0; i < SIDES; i++) step->sides[i] = e[i % 2 ? NODES - 1 : 0][i / 2];
  memcpy(step->y, run->y, sizeof step->y);
  total(step->t, h, step->s, step->sides, sums, run->u, run->parameters, step->y);
  return sqrt(worst / STATES);
}

/* By what the next step is longer. */
static double next_factor(double error, double largest) {
  double factor = SAFETY * pow(isfinite(error) ? error : sqrt(NOT_A_NUMBER), -PER_ORDER);
  return factor < MIN_FACTOR ? MIN_FACTOR : factor > largest ? largest : factor;
}

static void accept(Run *run, Step *step, double end) {
  double *place = run->record + run->steps++;
  memcpy(run->x, step->x, sizeof step->x);
  memcpy(run->y, step->y, sizeof step->y);
  *place = end;
  for (int j = 0; j < STATES; j++) *(place += run->room) = step->x[j];
  for (int j = 0; j < TOTALS; j++) *(place += run->room) = step->y[j];
  *(place += run->room) = run->u;
  for (int j = 0; j < SIDES; j++) *(place += run->room) = step->sides[j];
  memcpy(step->c[0], step->c[NODES - 1], sizeof step->c[0]); /* the next one begins there */
  step->t = end;
}

/* From one event to the next, in one step or in as many as the errors demand; whether it went. */
static int cross(Run *run, Step *step, double end) {
  double share = ERROR_SHARE * run->tolerance, shortest = SHORTEST_STEP * end;
  step->h = end - step->t;
  step->allowed = share;
  double error = try_step(run, step);
  if (error <= 1.0) {
    accept(run, step, end);
    return 1;
  }
  step->h *= next_factor(error, FIRST_MAX_FACTOR);
  for (int64_t i = 0; i < MAX_INTERVAL_STEPS; i++) {
    int last = step->t + step->h >= end * (1 - END_ROUNDING);
    step->h = last ? end - step->t : step->h > shortest ? step->h : shortest;
    int at_shortest = step->h <= shortest;
    step->allowed = at_shortest ? run->tolerance : share;
    error = try_step(run, step);
    if (error <= 1.0) {
      accept(run, step, last ? end : step->t + step->h);
      if (step->t >= end) return 1;
    } else if (at_shortest) {
      return 0;
    }
    step->h *= next_factor(error, MAX_FACTOR);
  }
  return 0;
}

/* Measure, evaluate the law; the command waits for the actuator. Whether there is one. */
static int take_sample(Run *run, double t, const double *s) {
  double m[MEASURED], c[LAW_COMMON + 1], u, *place = run->estimates + run->samples;
  for (int j = 0; j < run->estimated; j++, place += run->most_samples) *place = run->k[j];
  measure(run->x, run->parameters, m);
  for (int j = 0; j < MEASURED; j++) {
    if (run->errors) m[j] += run->errors[run->samples * MEASURED + j];
    if (run->quantum[j] > 0.0) m[j] = rint(m[j] / run->quantum[j]) * run->quantum[j];
  }
  law_common(t, s, c);
#ifdef PLANNED
  double base[MEASURED + 1];
  plan_base(t, s, m, run->parameters, run->k, base);
#endif
  law(c, m, run->parameters, run->k, &u);
#ifdef PLANNED
  if (!keep_plan_limits(&run->plan, run->samples, base, &u)) return 0;
#endif
  if (run->input_quantum > 0.0) {
    u = rint(u / run->input_quantum) * run->input_quantum;
    u = u < run->input_low ? run->input_low : u > run->input_high ? run->input_high : u;
  }
  run->waiting[run->samples++ % run->depth] = u;
  return 1;
}

/* Go on to event `until`, or until the record may have no room for the steps to the next one; 0,
 * or -1 where run.py has to do it. */
int integrate(Run *run, int64_t until) {
  Step step = {.s = NULL};
  for (; run->event < until && run->room - run->steps > MAX_INTERVAL_STEPS; run->event++) {
    int64_t now = run->event;
    double t = run->times[now];
    const double *s = run->shared + run->segments[now] * SHARED;
    if (run->kinds[now] & SAMPLE && !take_sample(run, run->clock[now], s)) return -1;
    if (run->kinds[now] & ACT) run->u = run->waiting[run->commands++ % run->depth];
    if (now + 1 == run->events) continue;
    if (step.s != s || step.t != t) {
      step.s = s;
      step.t = t;
      common_at(&step, t, step.c[0]);
    }
    if (!cross(run, &step, run->times[now + 1])) return -1;
    for (int j = 0; j < STATES; j++)
      if (!(fabs(run->x[j]) <= run->max_state)) return -1;
  }
  return 0;
}
