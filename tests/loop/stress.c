/* Random runs and units of a problem, NaN and infinity among their numbers: each must end in a status.
   The first argument is the number of runs. */

#include "fmi3.c"

static uint64_t seed = 88172645463325252u;

static uint64_t draw(void) {
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return seed;
}

static double uniform(void) { return (double)(draw() >> 11) / 9007199254740992.0; }

/* A number near another, or one that is seldom thought of. */
static double any_number(double usual) {
    static const double odd[] = {0.0, -0.0, 1.0, -1.0, 1e-300, 5e-324, 1e16, -1e16, 1e300, -1e300};
    switch (draw() % 24) {
    case 0: return NAN;
    case 1: return draw() % 2 ? INFINITY : -INFINITY;
    case 2: return odd[draw() % (sizeof odd / sizeof *odd)];
    case 3: return -usual;
    default: return usual * (0.5 + uniform()) + 0.3 * (uniform() - 0.5);
    }
}

/* A unit follows every impact until the limits of its settings: its numbers stay near the usual. */
static double unit_number(double usual) {
    switch (draw() % 8) {
    case 0: return NAN;
    case 1: return draw() % 2 ? INFINITY : -INFINITY;
    default: return usual * (0.9 + 0.2 * uniform());
    }
}

static void fill(double *to, const double *usual, long long n) {
    long long i;
    for (i = 0; i < n; i++) to[i] = draw() % 3 ? usual[i] : any_number(usual[i]);
}

static int counts[256];

static int run_once(zl_run *run, double *p, double *estimates, double *events) {
    zl_settings settings[ZL_STOPS];
    zl_records records = {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0};
    double x[ZL_MOST];
    int status, calls, k;
    fill(p, PROBLEM_parameters, problem->n_p);
    fill(x, PROBLEM_start, problem->n_x);
    settings[0] = PROBLEM_settings[0];
    settings[0].records = 0;
    settings[0].most_steps = 3000;
    settings[0].until = uniform() * PROBLEM_settings[0].until;
    settings[0].relative = pow(10.0, -3.0 - 9.0 * uniform());
    settings[0].absolute = settings[0].relative / 10.0;
    settings[0].begins_explicit = draw() % 4 != 0;
    if (draw() % 8 == 0) settings[0].restitution = any_number(0.9);
    for (k = 1; k < number_of_stops(); k++) {
        settings[k] = PROBLEM_settings[k];
        settings[k].records = 0;
        settings[k].most_steps = settings[0].most_steps;
        settings[k].until = settings[0].until;
        settings[k].relative = settings[0].relative;
        settings[k].absolute = settings[0].absolute;
        settings[k].begins_explicit = settings[0].begins_explicit;
    }
    records.events = events;
    records.most_events = ROOM;
    records.estimates = estimates;
    records.most_estimates = 4096;
    status = zl_begin(problem, run, settings, p, x);
    for (calls = 0; status == ZL_DONE || status == ZL_FULL || status == ZL_CURVE; calls++) {
        if (calls > 4000) break; /* impacts without end */
        status = zl_resume(problem, run, &records);
        if (status == ZL_DONE) break;
        if (status == ZL_CURVE) zl_answer(run, 0, 0.0, 0.0, PROBLEM_settings[0].sizes);
    }
    return status == ZL_FULL ? ZL_DONE : status;
}

static void unit_once(void) {
    static const bool no = false;
    const uint32_t n = (uint32_t)(problem->n_x + problem->n_p);
    double time = 0.0, value = 0.0, reached;
    bool flags[3];
    void *kept = 0;
    int count;
    void *unit = fmi3InstantiateCoSimulation("unit", INSTANTIATION_TOKEN, "", no, no, no, no, 0, 0,
                                             0, 0, 0);
    if (!unit) abort();
    for (count = 0; count < 3; count++) {
        const uint32_t ref = 1 + (uint32_t)(draw() % n);
        fmi3GetFloat64(unit, &ref, 1, &value, 1);
        value = unit_number(value);
        fmi3SetFloat64(unit, &ref, 1, &value, 1);
    }
    fmi3EnterInitializationMode(unit, no, 0.0, 0.0, draw() % 2, 4.0);
    if (fmi3ExitInitializationMode(unit) == OK)
        for (count = 0; count < 8; count++) {
            const uint32_t ref = (uint32_t)(draw() % (n + 8));
            const double size = 0.5 * uniform();
            if (draw() % 8 == 0) {
                fmi3GetFloat64(unit, &ref, 1, &value, 1);
                value = unit_number(value);
                fmi3SetFloat64(unit, &ref, 1, &value, 1);
            }
            if (draw() % 8 == 0) fmi3GetFMUState(unit, &kept);
            if (fmi3DoStep(unit, time, size, no, flags, flags + 1, flags + 2, &reached) != OK) break;
            time = reached;
        }
    if (kept) fmi3SetFMUState(unit, kept);
    fmi3FreeFMUState(unit, &kept);
    fmi3FreeInstance(unit);
}

int main(int n_words, char **words) {
    const int runs = n_words > 1 ? atoi(words[1]) : 100;
    zl_run *run = malloc(run_size());
    double *p = malloc(p_size()), *estimates = malloc(estimates_size(4096));
    double *events = malloc(ROOM * (ZL_EVENT_WIDTH + 2 * ZL_MOST) * sizeof(double));
    int k, status;
    if (!run || !p || !estimates || !events) return 2;
    for (k = 0; k < runs; k++) {
        status = run_once(run, p, estimates, events);
        if (status < 0 || status > ZL_MANY_SWITCHES) return 3;
        counts[status]++;
        if (k % 10 == 0) unit_once();
    }
    for (k = 0; k <= ZL_MANY_SWITCHES; k++) printf("%d ", counts[k]);
    printf("\n");
    free(events);
    free(estimates);
    free(p);
    free(run);
    return 0;
}
