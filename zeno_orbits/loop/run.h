/* A run: what an execution has to know of itself to go on. */

typedef struct {
    long long mode, n_y, implicit, on_guard, refused, has_last, has_slope, n_explicit;
    long long first_step, n_steps, first_polynomial, n_polynomials;
    double unit, launch, start_time, horizon, rounding, largest_explicit, largest_implicit;
    double time, size, last_size, earlier_size, fastest, first, largest_change, duration;
    double relative, absolute;
    double guard[2], y[ZL_MOST], slope[ZL_MOST], end[ZL_MOST], rates[2 * ZL_MOST];
    double coefficients[ZL_STAGES * ZL_MOST];
} Leg;

/* Newton's matrices of an implicit step as triangles, one real and three complex. */
typedef struct {
    double real[4][ZL_MOST * ZL_MOST], imaginary[4][ZL_MOST * ZL_MOST];
} Factors;

enum { BEFORE, AT_START, IN_LEG, AT_CURVE, OVER };

/* A guard beside that of the stop, in the present leg: at the start of a step, and its rounding. */
typedef struct {
    long long on_guard;
    double before[2], after[2], rounding, largest_change;
} Watched;

struct zl_run {
    zl_settings settings;
    zl_start start;
    zl_pace pace;
    Leg leg;
    zl_detail detail;
    double small_gap, small_rate, first_speed, spread[ZL_MODES];
    double answer_time, answer_error, answer[ZL_MOST];
    double refused; /* time of the last start in a mode that could not be followed */
    zl_detail first_detail; /* of the leg that a hop stands for */
    long long in_hop;
    long long stage, answered, n_impacts, n_landings, n_releases, n_arcs, n_rows, n_polynomials;
    long long has_jacobian[ZL_MODES], has_lanes[ZL_MODES];
    zl_place place;     /* at the start of the present arc */
    double limit; /* latest end of the present leg */
    double fall; /* of the guard that falls first, from the start of the step */
    long long begins_on_guard;
    Watched watched[ZL_GUARDS];
    Factors factors; /* the last: a run begins without them */
};

/* The parts of a block of memory: a run, then parameters and registers. */
typedef struct {
    const zl_problem *problem;
    zl_run *run;
    zl_records *records;
    double *p, *registers[ZL_TAPES], *lanes[ZL_MODES], *beside;
} Machine;

static int is_watched(int tape) { return ZL_WATCHED <= tape && tape < ZL_WATCHED + ZL_MODES; }

/* Numbers that the registers of a formula take. */
static long long room_of(const zl_problem *problem, int tape) {
    const zl_tape *formula = &problem->tapes[tape];
    return is_watched(tape) ? interval_room(formula) : formula->n_registers;
}

static Machine machine_of(const zl_problem *problem, zl_run *run, zl_records *records) {
    Machine m;
    double *place = (double *)(void *)(run + 1);
    int k;
    m.problem = problem;
    m.run = run;
    m.records = records;
    m.p = place;
    place += problem->n_p + 1;
    for (k = 0; k < ZL_TAPES; k++) {
        m.registers[k] = place;
        place += room_of(problem, k);
    }
    for (k = 0; k < ZL_MODES; k++) {
        m.lanes[k] = place;
        place += problem->tapes[ZL_RATE + k].n_registers * ZL_LANES;
    }
    m.beside = place;
    return m;
}

static void evaluate_at(const Machine *m, int tape, const double *varying, double *outputs) {
    if (KNOWN_STATES)
        compiled_formula(tape, m->registers[tape], varying, outputs);
    else
        tape_run(&m->problem->tapes[tape], m->registers[tape], varying, outputs);
}

static double number_at(const Machine *m, int tape, const double *x) {
    double outputs[2];
    evaluate_at(m, tape, x, outputs);
    return outputs[0];
}

static double *estimate_of(const Machine *m, long long k) {
    return m->records->estimates + k * (ZL_ESTIMATE_WIDTH + 2 * m->problem->n_x);
}
