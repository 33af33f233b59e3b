/* The first input of a plan within its limits: planned_input.py in C.
 *
 * With w = 0 the inputs of a plan are those of the formula, `plan`; the smallest w with
 * low <= plan + L w <= high is found by the dual method of D. Goldfarb and A. Idnani (Mathematical
 * Programming 27, 1983, 1-33): from w = 0 one violated limit after the other is met, the active
 * ones with nonnegative multipliers. Every change of active limits lowers the dual, so it ends.
 */

/* Changes of active limits at most: of numbers that rounding spoils, there is no end. */
enum { MOVES = PLAN_MOVES, MOST_CHANGES = 100 * PLAN_MOVES };

/* A normal this small against its limit's own lies in the span of the active ones. */
static const double DEPENDENT = 1e-13;

/* Of a run: the formulas' plan at sample i is u_law + spread x + offsets[i]. */
typedef struct {
  const double *spread;  /* MOVES x MEASURED */
  const double *offsets; /* samples x MOVES */
  const double *effect;  /* L, MOVES x MOVES, lower triangular */
  double low, high, tolerance;
} Plan; /* LimitedPlans of plans.py */

/* Limits that hold with equality: sign * (L w)_row = sign * bound. */
typedef struct {
  int count, row[MOVES];
  double sign[MOVES], multiplier[MOVES];
} ActiveLimits;

static double product(const double *a, const double *b) {
  double sum = 0.0;
  for (int i = 0; i < MOVES; i++) sum += a[i] * b[i];
  return sum;
}

/* r with N r the projection of a normal onto the span of the active ones, by Cholesky's method. */
static void projection(const double *L, const ActiveLimits *a, const double *normal, double *r) {
  double f[MOVES][MOVES];
  for (int i = 0; i < a->count; i++) {
    const double *row = L + a->row[i] * MOVES;
    double right = a->sign[i] * product(row, normal);
    for (int j = 0; j <= i; j++) {
      double sum = a->sign[i] * a->sign[j] * product(row, L + a->row[j] * MOVES);
      for (int k = 0; k < j; k++) sum -= f[i][k] * f[j][k];
      f[i][j] = i == j ? sqrt(sum > 1e-300 ? sum : 1e-300) : sum / f[j][j];
    }
    for (int k = 0; k < i; k++) right -= f[i][k] * r[k];
    r[i] = right / f[i][i];
  }
  for (int i = a->count - 1; i >= 0; i--) {
    for (int k = i + 1; k < a->count; k++) r[i] -= f[k][i] * r[k];
    r[i] /= f[i][i];
  }
}

/* Meet one violated limit, `missing` < 0 away; whether that was possible. */
static int meet(const double *L, ActiveLimits *a, double *w, int row, double sign, double missing) {
  double normal[MOVES], z[MOVES], r[MOVES], multiplier = 0.0;
  for (int i = 0; i < MOVES; i++) normal[i] = sign * L[row * MOVES + i];
  for (int changes = 0; changes < MOVES + 1; changes++) {
    double dual = INFINITY, primal = INFINITY;
    int leaves = -1;
    projection(L, a, normal, r);
    memcpy(z, normal, sizeof z);
    for (int j = 0; j < a->count; j++)
      for (int i = 0; i < MOVES; i++) z[i] -= r[j] * a->sign[j] * L[a->row[j] * MOVES + i];
    double along = product(z, normal);
    if (along > DEPENDENT * product(normal, normal)) primal = -missing / along;
    for (int j = 0; j < a->count; j++)
      if (r[j] > 0.0 && a->multiplier[j] / r[j] < dual) {
        dual = a->multiplier[j] / r[j];
        leaves = j;
      }
    double step = primal <= dual ? primal : dual;
    if (!(step < INFINITY)) return 0;
    for (int j = 0; j < a->count; j++) a->multiplier[j] -= step * r[j];
    multiplier += step;
    if (primal < INFINITY) {
      for (int i = 0; i < MOVES; i++) w[i] += step * z[i];
      missing += step * along;
    }
    if (primal <= dual) {
      if (a->count == MOVES) return 0;
      a->row[a->count] = row;
      a->sign[a->count] = sign;
      a->multiplier[a->count++] = multiplier;
      return 1;
    }
    for (int j = leaves + 1; j < a->count; j++) {
      a->row[j - 1] = a->row[j];
      a->sign[j - 1] = a->sign[j];
      a->multiplier[j - 1] = a->multiplier[j];
    }
    a->count--;
  }
  return 0;
}

/* The input at sample i, where the law's formula without limits says base[0] and takes base + 1 for
 * the states; *u is changed where the formula's own plan leaves the limits. Whether it was found. */
static int keep_plan_limits(const Plan *plan, int64_t i, const double *base, double *u) {
  double inputs[MOVES], w[MOVES] = {0.0};
  ActiveLimits active = {.count = 0};
  for (int j = 0; j < MOVES; j++) {
    inputs[j] = base[0] + plan->offsets[i * MOVES + j];
    for (int k = 0; k < MEASURED; k++) inputs[j] += plan->spread[j * MEASURED + k] * base[1 + k];
  }
  for (int changes = 0; changes < MOST_CHANGES; changes++) {
    int row = -1;
    double sign = 0.0, most = changes ? plan->tolerance : 0.0;
    for (int j = 0; j < MOVES; j++) {
      double now = inputs[j];
      if (changes) now += product(plan->effect + j * MOVES, w);
      if (!isfinite(now)) return 0;
      if (now - plan->high > most) {
        row = j;
        sign = -1.0;
        most = now - plan->high;
      }
      if (plan->low - now > most) {
        row = j;
        sign = 1.0;
        most = plan->low - now;
      }
    }
    if (row < 0) {
      if (!changes) return 1;
      double first = inputs[0] + w[0];
      *u = first < plan->low ? plan->low : first > plan->high ? plan->high : first;
      return 1;
    }
    if (!meet(plan->effect, &active, w, row, sign, -most)) return 0;
  }
  return 0;
}
