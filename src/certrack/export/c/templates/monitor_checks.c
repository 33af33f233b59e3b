#define PROBES ${probes}
#define FLAGS ${count}

/* A sample, and the flags at it: 0 down, 1 up, 2 where rounding decides. */
typedef struct {
    ${name}_state before;
    ${name}_real u_before;
    ${name}_real x[${name}_STATES];
    ${name}_real y_d[${name}_REFERENCES];
    int flags[FLAGS];
} probe;

static const probe probes[PROBES] = {
${table}
};

static const ${name}_state ones = ${ones};

/* Flags of the command: down while the controller is disabled. */
static const bool of_command[FLAGS] = {${of_command}};

static void expect(${name}_real *worst, bool holds)
{
    compare(worst, holds ? ${zero} : ${one}, ${zero}, ${one});
}

static void list_flags(const ${name}_flags *f, bool list[FLAGS])
{
${listed}
}

/* Whether a flag is up, and no other one. */
static bool alone(const ${name}_flags *f, int flag)
{
    bool list[FLAGS];
    bool good = true;
    int i;

    list_flags(f, list);
    for (i = 0; i < FLAGS; i++) {
        good = good && (list[i] == (i == flag));
    }
    return good;
}

static void set_monitor(${name}_monitor *m, const probe *q)
{
    ${name}_monitor_init(m);
    m->state = q->before;
    m->u = q->u_before;
}

${clipped}/* The step of the controller, and the flags that are expected. */
static void check_enabled(${name}_real *worst, const probe *q)
{
    ${name}_state s = q->before;
    ${name}_monitor m;
    bool now[FLAGS];
    bool latched[FLAGS];
    int i;
${limited}
    set_monitor(&m, q);
    compare(worst, ${name}_monitored_step(&m, true, q->x, q->y_d),
        ${name}_step(&s, ${p}q->x, ${y_d}), ${one});
    compare_states(worst, &m.state, &s, &ones);
    list_flags(&m.now, now);
    list_flags(&m.latched, latched);
    expect(worst, ${name}_premises_hold(&m) == alone(&m.latched, FLAGS));
    for (i = 0; i < FLAGS; i++) {
        expect(worst, (q->flags[i] == 2) || (now[i] == (q->flags[i] == 1)));
        expect(worst, latched[i] == now[i]);
    }
    ${name}_clear_flags(&m);
    expect(worst, alone(&m.latched, FLAGS) && ${name}_premises_hold(&m));
}

/* No command, no learning, no latched flag; the flags of the inputs are those of the probe. */
static void check_disabled(${name}_real *worst, const probe *q)
{
    ${name}_monitor m;
    bool now[FLAGS];
    int i;

    set_monitor(&m, q);
    compare(worst, ${name}_monitored_step(&m, false, q->x, q->y_d), ${off}, ${one});
    compare(worst, m.u, ${off}, ${one});
    expect(worst, ${name}_premises_hold(&m));
    list_flags(&m.now, now);
    for (i = 0; i < FLAGS; i++) {
        expect(worst, of_command[i] ? !now[i] : ((q->flags[i] == 2) || (now[i] == (q->flags[i] == 1))));
    }
${disabled}    ${name}_reset_estimates(&m);
${restarted}}

/* One bad input holds everything and raises its own flag alone. */
static void check_held(${name}_real *worst, const probe *q)
{
    ${name}_monitor m;
    int i;

    for (i = 0; i < (${name}_STATES + ${name}_REFERENCES); i++) {
        probe bad = *q;

        if (i < ${name}_STATES) {
            bad.x[i] = (${name}_real)NAN;
        } else {
            bad.y_d[i - ${name}_STATES] = (${name}_real)INFINITY;
        }
        if (!${name}_valid(bad.x, bad.y_d)) {
            set_monitor(&m, q);
            compare(worst, ${name}_monitored_step(&m, true, bad.x, bad.y_d), q->u_before, ${one});
            compare_states(worst, &m.state, &q->before, &ones);
            expect(worst, alone(&m.now, 0));
        }
    }
}

${parameter_checks}static void check_monitor(${name}_real *worst)
{
    ${name}_state s;
    ${name}_monitor m;
    int i;

    ${name}_init(&s);
    ${name}_monitor_init(&m);
    compare_states(worst, &m.state, &s, &ones);
    compare(worst, m.u, ${off}, ${one});
    expect(worst, alone(&m.now, FLAGS) && alone(&m.latched, FLAGS));
${latched}
    for (i = 0; i < PROBES; i++) {
        check_enabled(worst, &probes[i]);
        check_disabled(worst, &probes[i]);
        check_held(worst, &probes[i]);
    }
${parameter_call}}

