/* What a run is judged by, from the Taylor series of its steps: simulation/metrics.py and refine.py
 * in C, for runs of few steps, where these spend their time on calls for short arrays.
 *
 * Nothing of the system is compiled, so one library serves all: the signals e_1 and u come as a
 * list of operations on registers. A register is a block of POINTS times on each of LANES steps.
 */
#include "vector_math.h"

enum { POINTS = 9, TURNS = POINTS - 2, ROUNDS = 3, SIGNALS = 3, MAX_SEARCHES = 8192 };
enum { ERROR, INPUT, INTEGRAL };

/* The operations, in the order of signal_program.py. */
enum { ADD, MULTIPLY, DIVIDE, LARGER, SMALLER, ABOVE, CHOOSE, POW, ATAN2, ABS, SIGN, SQRT, SIN, COS,
       EXP, LOGARITHM, TAN, ASIN, ACOS, ATAN, SINH, COSH, TANH };

/* Larger samples are of a run that escapes: no peak is refined there. */
static const double MAX_REFINED = 1e100;

ELEMENTARY(tan) ELEMENTARY(asin) ELEMENTARY(acos) ELEMENTARY(atan) ELEMENTARY(sinh)
ELEMENTARY(cosh) ELEMENTARY(tanh) ELEMENTARY_OF_TWO(pow) ELEMENTARY_OF_TWO(atan2)

typedef V Block[POINTS];

typedef struct {
  int64_t steps, states, orders;
  const double *starts, *table; /* steps; steps x states x orders */
  double end;
  const double *fractions; /* POINTS: where on a step its samples lie */
  int64_t used;
  const int32_t *which; /* `used` states: those of the signals, then the integral of e_1 */
  int64_t scalars, pieces;
  const double *values, *held; /* scalars; steps x pieces */
  int64_t operations;
  const int32_t *code; /* operations x 4: what, and of which registers */
  int64_t outputs[2]; /* registers of e_1 and u */
  double scale; /* of the integral */
  double band, tail_start;
  int64_t smooth, most; /* no kink lies inside a step; extremes of one signal at most */
  double *results; /* settling time, tail error, integral of |e_1|, peak and variation of u, then
                      the integrals of u^2 and e_1^2 at the end, which are states */
} Task;

/* An interval of one step on which a signal has an extreme, or falls to a level. */
typedef struct {
  int64_t step;
  int signal, extreme;
  double begin, end; /* since the step's begin */
  double sign, level, sampled, found;
} Search;

/* Registers: the signals' states, the time, scalars, pieces, and what each operation gives. */
typedef struct {
  Block *registers, out[SIGNALS];
  double *series; /* orders x LANES */
  double *t, *signal[SIGNALS]; /* at all samples */
  Search *searches;
} Memory;

static double length_of(const Task *task, int64_t step) {
  return (step + 1 < task->steps ? task->starts[step + 1] : task->end) - task->starts[step];
}

#define EACH(formula) \
  for (int p = 0; p < POINTS; p++) out[p] = formula; \
  break

static void operate(int what, const V *a, const V *b, const V *c, V *out) {
  switch (what) {
    case ADD: EACH(a[p] + b[p]);
    case MULTIPLY: EACH(a[p] * b[p]);
    case DIVIDE: EACH(a[p] / b[p]);
    case LARGER: EACH(v_max(a[p], b[p]));
    case SMALLER: EACH(v_min(a[p], b[p]));
    case ABOVE: EACH(greater(a[p], b[p], SPLAT(1.0), SPLAT(0.0)));
    case CHOOSE: EACH(greater(a[p], SPLAT(0.5), b[p], c[p]));
    case POW: EACH(v_pow(a[p], b[p]));
    case ATAN2: EACH(v_atan2(a[p], b[p]));
    case ABS: EACH(v_abs(a[p]));
    case SIGN: EACH(v_sign(a[p]));
    case SQRT: EACH(v_sqrt(a[p]));
    case SIN: EACH(v_sin(a[p]));
    case COS: EACH(v_cos(a[p]));
    case EXP: EACH(v_exp(a[p]));
    case LOGARITHM: EACH(v_log(a[p]));
    case TAN: EACH(v_tan(a[p]));
    case ASIN: EACH(v_asin(a[p]));
    case ACOS: EACH(v_acos(a[p]));
    case ATAN: EACH(v_atan(a[p]));
    case SINH: EACH(v_sinh(a[p]));
    case COSH: EACH(v_cosh(a[p]));
    case TANH: EACH(v_tanh(a[p]));
  }
}

/* The signals at `since` the begins of LANES steps: Horner's rule, then the operations. */
static void evaluate(const Task *task, Memory *m, const int64_t *step, const V *since) {
  int64_t orders = task->orders, last = task->used - 1;
  Block *r = m->registers;
  for (int64_t j = 0; j <= last; j++) {
    for (int l = 0; l < LANES; l++) {
      const double *row = task->table + (step[l] * task->states + task->which[j]) * orders;
      for (int64_t o = 0; o < orders; o++) m->series[o * LANES + l] = row[o];
    }
    V *value = j < last ? r[j] : m->out[INTEGRAL];
    const V *series = (const V *)m->series;
    for (int p = 0; p < POINTS; p++) value[p] = series[orders - 1];
    for (int64_t o = orders - 2; o >= 0; o--)
      for (int p = 0; p < POINTS; p++) value[p] = value[p] * since[p] + series[o];
  }
  V begin = SPLAT(0.0);
  for (int l = 0; l < LANES; l++) begin[l] = task->starts[step[l]];
  for (int p = 0; p < POINTS; p++) {
    r[last][p] = begin + since[p];
    m->out[INTEGRAL][p] *= task->scale;
  }
  Block *held = r + last + 1 + task->scalars, *next = held + task->pieces;
  for (int64_t j = 0; j < task->pieces; j++) {
    V value = SPLAT(0.0);
    for (int l = 0; l < LANES; l++) value[l] = task->held[step[l] * task->pieces + j];
    for (int p = 0; p < POINTS; p++) held[j][p] = value;
  }
  const int32_t *code = task->code;
  for (int64_t i = 0; i < task->operations; i++, code += 4)
    operate(code[0], r[code[1]], r[code[2]], r[code[3]], next[i]);
  for (int i = 0; i < 2; i++) memcpy(m->out[i], r[task->outputs[i]], sizeof(Block));
}

/* All samples of all steps; whether they are finite. */
static int sample(const Task *task, Memory *m) {
  int64_t step[LANES];
  V since[POINTS];
  for (int64_t first = 0; first < task->steps; first += LANES) {
    for (int l = 0; l < LANES; l++) {
      int64_t k = step[l] = first + l < task->steps ? first + l : task->steps - 1;
      double h = length_of(task, k);
      for (int p = 0; p < POINTS; p++) since[p][l] = h * task->fractions[p];
      if (k == 0) since[0][l] = 0.0; /* begin and end of the run are hit exactly */
      if (k == task->steps - 1) since[POINTS - 1][l] = h;
    }
    evaluate(task, m, step, since);
    for (int l = 0; l < LANES && first + l < task->steps; l++)
      for (int p = 0; p < POINTS; p++) {
        int64_t i = (first + l) * POINTS + p;
        m->t[i] = task->starts[step[l]] + since[p][l];
        for (int j = 0; j < SIGNALS; j++) {
          m->signal[j][i] = m->out[j][p][l];
          if (!isfinite(m->signal[j][i])) return 0;
        }
      }
  }
  return 1;
}

/* Whether the samples may have an extreme around sample k + 1 of a step, whose rises are given. */
static int turns(const double *rise, int k) {
  if (rise[k] * rise[k + 1] <= 0.0) return 1;
  if (k != 0 && k != TURNS - 1) return 0;
  int edge = k ? POINTS - 2 : 0, inner = k ? POINTS - 3 : 1;
  double sum = rise[edge] + rise[inner], bend = 2 * (rise[inner] - rise[edge]);
  return sum * bend > 0.0 && fabs(sum) <= fabs(bend);
}

/* Where samples of a signal suggest an extreme: of the input everywhere; of e_1 from `start` on
 * where twice the gain that a parabola promises exceeds `best`. -1 where there are too many. */
static int64_t find_extremes(const Task *task, Memory *m, int signal, double best, int64_t count) {
  int64_t before = count;
  const double *f = m->signal[signal];
  for (int64_t step = 0; step < task->steps; step++) {
    const double *s = f + step * POINTS, *t = m->t + step * POINTS;
    double rise[POINTS - 1];
    for (int p = 0; p < POINTS - 1; p++) rise[p] = s[p + 1] - s[p];
    for (int k = 0; k < TURNS; k++) {
      if (!turns(rise, k)) continue;
      double bend = s[k] - 2 * s[k + 1] + s[k + 2], across = s[k + 2] - s[k];
      if (bend == 0.0 || fabs(s[k + 1]) >= MAX_REFINED) continue;
      double sign = bend < 0.0 ? 1.0 : -1.0;
      double top = sign * (s[k + 1] - across * across / (8 * bend)), sampled = sign * s[k];
      for (int p = k + 1; p <= k + 2; p++) sampled = fmax(sampled, sign * s[p]);
      double start = task->starts[step], begin = t[k] - start;
      if (signal == ERROR) {
        if (t[k + 2] <= task->tail_start || 2 * top - sampled <= best) continue;
        if (t[k] < task->tail_start) begin = task->tail_start - start;
      }
      if (count - before == task->most || count == MAX_SEARCHES) return -1;
      m->searches[count++] = (Search){step, signal, 1, begin, t[k + 2] - start,
                                      sign, 0.0, sampled, 0.0};
    }
  }
  return count;
}

/* One search where e_1 passes a level behind sample i; where a step ends, a chord is exact. */
static int64_t add_crossing(const Task *task, Memory *m, int64_t i, double level, int64_t count) {
  const double *e = m->signal[ERROR];
  double sign = e[i] < 0.0 ? -1.0 : 1.0, start = task->starts[i / POINTS];
  if (count == MAX_SEARCHES) return -1;
  Search *s = m->searches + count;
  *s = (Search){i / POINTS, ERROR, 0, m->t[i] - start, m->t[i + 1] - start, sign, level, 0.0, 0.0};
  if (i % POINTS == POINTS - 1) {
    double above = sign * e[i] - level, below = sign * e[i + 1] - level;
    s->signal = -1;
    s->found = s->begin + (s->end - s->begin) * (above / (above - below));
  }
  return count + 1;
}

/* The place of the largest of a search's values, with neighbours on both sides. */
static int inner_top(const double *values) {
  int top = 0;
  for (int p = 1; p < POINTS; p++)
    if (values[p] > values[top]) top = p;
  return top < 1 ? 1 : top > POINTS - 2 ? POINTS - 2 : top;
}

/* Newton's step from the largest of equidistant values, by their slopes. */
static double vertex(const double *values) {
  const double *f = values + inner_top(values);
  double bend = f[-1] - 2 * f[0] + f[1], shift = (f[-1] - f[1]) / (2 * bend);
  return bend < 0.0 && fabs(shift) <= 1.0 ? f[0] + (f[1] - f[-1]) * shift / 4 : -INFINITY;
}

/* A grid of a search was evaluated: the interval of the next one, or the result. */
static void narrow(Search *s, const double *since, const double *values, int last_round,
                   int smooth) {
  if (s->extreme) {
    int top = inner_top(values);
    for (int p = 0; p < POINTS; p++) s->found = fmax(s->found, values[p]);
    if (last_round && smooth) s->found = fmax(s->found, vertex(values));
    s->begin = since[top - 1];
    s->end = since[top + 1];
    return;
  }
  int last = POINTS - 2;
  while (last > 0 && values[last] <= 0.0) last--;
  if (values[last] <= 0.0) last = POINTS - 2;
  double above = values[last], below = values[last + 1];
  double share = above > 0.0 && below <= 0.0 ? above / (above - below) : 1.0;
  s->begin = since[last];
  s->end = since[last + 1];
  s->found = s->begin + (s->end - s->begin) * share;
}

/* Refine LANES searches on finer and finer grids. */
static void refine(const Task *task, Memory *m, Search **searches) {
  int64_t step[LANES];
  V since[POINTS];
  for (int l = 0; l < LANES; l++) step[l] = searches[l]->step;
  for (int round = 0; round < ROUNDS; round++) {
    for (int l = 0; l < LANES; l++) {
      double begin = searches[l]->begin, width = searches[l]->end - begin;
      for (int p = 0; p < POINTS; p++) since[p][l] = begin + width * (p / (POINTS - 1.0));
    }
    evaluate(task, m, step, since);
    for (int l = 0; l < LANES; l++) {
      double values[POINTS], times[POINTS];
      Search *s = searches[l];
      if (l && s == searches[l - 1]) continue; /* fills a lane that is left over */
      for (int p = 0; p < POINTS; p++) {
        times[p] = since[p][l];
        values[p] = s->sign * m->out[s->signal][p][l] - s->level;
      }
      narrow(s, times, values, round == ROUNDS - 1, (int)task->smooth);
    }
  }
}

/* e_1 at a time. */
static double error_at(const Task *task, Memory *m, double t) {
  int64_t step[LANES], k = task->steps - 1;
  V times[POINTS];
  while (k > 0 && task->starts[k] > t) k--;
  for (int l = 0; l < LANES; l++) step[l] = k;
  for (int p = 0; p < POINTS; p++) times[p] = SPLAT(t - task->starts[k]);
  evaluate(task, m, step, times);
  return m->out[ERROR][0][0];
}

/* A state at the end of the run. */
static double end_of(const Task *task, int64_t state) {
  int64_t last = task->steps - 1;
  const double *row = task->table + (last * task->states + state) * task->orders;
  double value = row[task->orders - 1], h = length_of(task, last);
  for (int64_t o = task->orders - 2; o >= 0; o--) value = value * h + row[o];
  return value;
}

/* The integral of |e_1|: that of e_1, split where e_1 changes its sign; LANES zeros at once. */
static double integral_of_magnitude(const Task *task, Memory *m, int64_t begin, int64_t end) {
  const double *running = m->signal[INTEGRAL];
  double total = 0.0, mark = running[0];
  for (int64_t first = begin; first < end; first += LANES) {
    int64_t step[LANES];
    V since[POINTS];
    for (int l = 0; l < LANES; l++) {
      const Search *s = m->searches + (first + l < end ? first + l : end - 1);
      step[l] = s->step;
      for (int p = 0; p < POINTS; p++) since[p][l] = s->found;
    }
    evaluate(task, m, step, since);
    for (int l = 0; l < LANES && first + l < end; l++) {
      total += fabs(m->out[INTEGRAL][0][l] - mark);
      mark = m->out[INTEGRAL][0][l];
    }
  }
  return total + fabs(running[task->steps * POINTS - 1] - mark);
}

/* 0, or 1 where metrics.py has to do it: too many extremes, or signals that are not finite. */
static int measure(const Task *task, Memory *m) {
  if (!sample(task, m)) return 1;
  int64_t samples = task->steps * POINTS, first = 0, outside = -1;
  const double *e = m->signal[ERROR], *u = m->signal[INPUT], *t = m->t;
  double tail = NAN, peak = 0.0, variation = 0.0;
  while (first < samples && t[first] < task->tail_start) first++;
  for (int64_t i = first; i < samples; i++) tail = fmax(tail, fabs(e[i]));
  for (int64_t i = 0; i < samples; i++) {
    peak = fmax(peak, fabs(u[i]));
    if (i) variation += fabs(u[i] - u[i - 1]);
    if (fabs(e[i]) > task->band) outside = i;
  }
  int64_t count = find_extremes(task, m, INPUT, 0.0, 0);
  if (count >= 0 && first < samples) count = find_extremes(task, m, ERROR, tail, count);
  if (count < 0) return 1;
  int64_t zeros = count;
  for (int64_t i = 0; i + 1 < samples && count >= 0; i++)
    if ((e[i + 1] < 0.0) != (e[i] < 0.0)) count = add_crossing(task, m, i, 0.0, count);
  if (count < 0) return 1;
  int64_t settles = count;
  if (outside >= 0 && outside < samples - 1)
    count = add_crossing(task, m, outside, task->band, count);
  if (count < 0) return 1;

  Search *lane[LANES];
  int waiting = 0;
  for (int64_t i = 0; i < count; i++) {
    Search *s = m->searches + i;
    if (s->extreme) s->found = -INFINITY;
    if (s->signal >= 0) lane[waiting++] = s;
    if (waiting == LANES || (i == count - 1 && waiting)) {
      for (int l = waiting; l < LANES; l++) lane[l] = lane[waiting - 1];
      refine(task, m, lane);
      waiting = 0;
    }
  }
  for (int64_t i = 0; i < zeros; i++) {
    const Search *s = m->searches + i;
    if (s->signal == ERROR) tail = fmax(tail, s->found);
    if (s->signal == INPUT) peak = fmax(peak, fabs(s->found));
    if (s->signal == INPUT) variation += 2 * fmax(s->found - s->sampled, 0.0);
  }
  if (t[0] < task->tail_start && task->tail_start <= t[samples - 1])
    tail = fmax(tail, fabs(error_at(task, m, task->tail_start)));
  double settled = outside < 0 ? 0.0 : NAN;
  if (settles < count)
    settled = task->starts[m->searches[settles].step] + m->searches[settles].found;
  double magnitude = integral_of_magnitude(task, m, zeros, settles);
  const double results[] = {settled, tail, magnitude, peak, variation,
                            end_of(task, task->states - 3), end_of(task, task->states - 2)};
  memcpy(task->results, results, sizeof results);
  return 0;
}

/* Measure a run; returns 0, 1 where metrics.py has to do it, or -1 without memory. */
int integrate(const Task *task) {
  int64_t scalars = task->used + task->scalars, samples = task->steps * POINTS;
  size_t blocks = (size_t)(scalars + task->pieces + task->operations + 1);
  size_t numbers = (size_t)(task->orders * LANES + (SIGNALS + 1) * samples);
  char *place = NULL;
  size_t size = sizeof(Memory) + blocks * sizeof(Block) + numbers * sizeof(double);
  if (posix_memalign((void **)&place, 64, size + MAX_SEARCHES * sizeof(Search))) return -1;
  Memory *m = (Memory *)place;
  m->registers = (Block *)(place + sizeof *m);
  m->series = (double *)(m->registers + blocks);
  m->t = m->series + task->orders * LANES;
  for (int j = 0; j < SIGNALS; j++) m->signal[j] = m->t + (j + 1) * samples;
  m->searches = (Search *)(place + size);
  for (int64_t j = 0; j < task->scalars; j++)
    for (int p = 0; p < POINTS; p++) m->registers[task->used + j][p] = SPLAT(task->values[j]);
  int status = measure(task, m);
  free(place);
  return status;
}
