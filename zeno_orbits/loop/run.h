/* A run: what an execution has to know of itself to go on. */

typedef struct {
    long long mode, n_y, implicit, on_guard, refused, has_last, has_slope, n_explicit;
    long long first_step, n_steps, first_polynomial, n_polynomials;
    double unit, launch, height, start_time, horizon, late, rounding, largest_explicit, largest_implicit;
    double time, size, wanted, last_size, earlier_size, fastest, first, largest_change, duration;
    double relative, absolute;
    double guard[2], y[ZL_MOST], slope[ZL_MOST], end[ZL_MOST], rates[2 * ZL_MOST];
    double coefficients[ZL_STAGES * ZL_MOST];
} Leg;

/* Newton's matrices of an implicit step as triangles, one real and three complex. */
typedef struct {
    double real[4][ZL_MOST * ZL_MOST], imaginary[4][ZL_MOST * ZL_MOST];
} Factors;

enum { BEFORE, AT_START, IN_LEG, AT_CURVE, OVER, LAUNCHES, ENDED, DECIDES, IN_SIDE };

/* A guard beside that of the stop, in the present leg: at the start of a step, and how it ends. */
typedef struct {
    long long on_guard, began_on_guard, outcome, n_steps, n_polynomials;
    double before[2], after[2], rounding, largest_change;
    double launched, height;        /* speed and scaled gap of the flight from a stop just left, or 0 */
    double at, until, end[ZL_MOST]; /* of its end: time, end of the step, state */
} Watched;

/* A flight that is lower than the rounding of the gap: its duration, 0 if there is none, and the
   scaled gap rate at its start with its error, and the scaled gap there. It comes first, or where
   another arc failed. */
typedef struct {
    double duration, launch, error, height;
    int comes_first;
} Hop;

/* What a run knows of modes and events: `reference_run` and `accumulations` in Python. Sets of stops and
   switches are bits. */
typedef struct {
    long long view, rest, focus, sides, above;
    long long together; /* the stops that open at the end of an arc, if there are several */
    /* The sequence of impacts that a kink may have split, the kinks and switches of dry friction that
       split its flights, its first estimate that counts, and those switches in the flight before the
       last estimate. */
    long long has_current, current_rest, current_focus, split_before, split_present;
    long long first_node, beside;
    long long flipped; /* the switches of which a start was on the wrong side at `flipped_time` */
    long long n_switches, has_events, last_switch;
    double flipped_time;
    long long n_turn, turn_stops[IN_TURN], n_row[ZL_GUARDS];
    double turn_times[IN_TURN], row_times[ZL_GUARDS][IN_ROW];
    double met_times[ZL_STOPS], met_gaps[ZL_STOPS]; /* of each stop: when it was last struck or opened,
                                                       and the gap that was left */
    /* Of the present arc: what it is, whether every guard is followed to its end, and its window. */
    long long kind, careful, retried, outcome, undefined, next_guard, found, in_side;
    double window, horizon, limit;
    Hop hop;
    long long first_status;
    zl_detail failed; /* of the first step that failed */
    zl_pace pace;     /* at the start of the arc */
} Graphed;

struct zl_run {
    zl_start start;
    zl_pace pace;
    Leg leg;
    zl_detail detail;
    double small_gap, small_rate, first_speed, refused; /* time of the last start that ended at once */
    zl_detail first_detail; /* of the leg that a hop stands for */
    long long in_hop;
    long long stage, answered, n_impacts, n_landings, n_releases, n_arcs, n_rows, n_polynomials;
    Graphed graph;
    zl_settings settings; /* from here on nothing is repeated that asks for a missing mode */
    double spread[ZL_MODES];
    double answer_time, answer_error, answer[ZL_MOST];
    Factors factors; /* from here on a run begins with anything */
    Leg main, side;  /* an arc, and the flight of another stop that is left with it */
    Watched watched[ZL_GUARDS];
};

/* A guard beside that of the stop: its formulas and their registers, in the present mode. */
typedef struct {
    int kind, index; /* the event: ZL_IMPACT, ZL_RELEASE or ZL_SWITCH; the stop or switch */
    double sign;     /* side of a switch: its guard is the formula times this */
    const zl_tape *value, *bounds;
    double *registers, *bounds_registers;
} Other;

typedef struct {
    int n;
    Other list[ZL_GUARDS];
} Others;

/* Which registers of a view are ready. They follow it. */
typedef struct {
    long long prepared, has_jacobian[ZL_MODES], has_lanes[ZL_MODES], unused;
} Ready;

/* A view of a run, and its parts of a block of memory: the run, the settings of every stop, parameters
   and formulas that all views share, and those of every view. */
typedef struct {
    const zl_problem *problem;
    const zl_graph *graph;
    zl_run *run;
    zl_records *records;
    const zl_settings *settings;
    const Others *others; /* or null */
    Ready *ready;
    double *p, *registers[ZL_TAPES], *lanes[ZL_MODES];
} Machine;

static int is_watched(int tape) { return ZL_WATCHED <= tape && tape < ZL_WATCHED + ZL_MODES; }

/* Numbers that the registers of a formula take. */
static long long room_of(const zl_problem *problem, int tape) {
    const zl_tape *formula = &problem->tapes[tape];
    return is_watched(tape) ? interval_room(formula) : formula->n_registers;
}

/* Numbers that a view takes. */
static long long numbers_of(const zl_problem *problem) {
    long long n = (long long)(sizeof(Ready) / sizeof(double)) + problem->n_p + 1;
    int k;
    for (k = 0; k < ZL_TAPES; k++) n += room_of(problem, k);
    for (k = 0; k < ZL_MODES; k++) n += problem->tapes[ZL_RATE + k].n_registers * ZL_LANES;
    return n;
}

static Machine machine_at(const zl_problem *problem, zl_run *run, zl_records *records,
                          double *place) {
    Machine m;
    int k;
    m.problem = problem;
    m.graph = 0;
    m.run = run;
    m.records = records;
    m.settings = &run->settings;
    m.others = 0;
    m.ready = (Ready *)(void *)place;
    m.p = place += sizeof(Ready) / sizeof(double);
    place += problem->n_p + 1;
    for (k = 0; k < ZL_TAPES; k++) {
        m.registers[k] = place;
        place += room_of(problem, k);
    }
    for (k = 0; k < ZL_MODES; k++) {
        m.lanes[k] = place;
        place += problem->tapes[ZL_RATE + k].n_registers * ZL_LANES;
    }
    return m;
}

/* What the views of a graph share: the settings of each stop, parameters, formulas of the graph. */
static zl_settings *settings_at(zl_run *run) { return (zl_settings *)(void *)(run + 1); }

static double *parameters_at(const zl_graph *graph, zl_run *run) {
    return (double *)(void *)(settings_at(run) + graph->n_stops);
}

static double *numbers_at(const zl_problem *problem, zl_run *run) {
    return parameters_at(problem->graph, run) + problem->n_p;
}

static void prepare_formulas(const Machine *m, const double *p) {
    const zl_problem *problem = m->problem;
    int k;
    memset(m->ready, 0, sizeof *m->ready);
    memcpy(m->p, p, (size_t)problem->n_p * sizeof(double));
    m->p[problem->n_p] = NAN;
    for (k = 0; k < ZL_TAPES; k++)
        if (is_watched(k))
            intervals_prepare(&problem->tapes[k], m->registers[k], m->p);
        else if ((k < ZL_JACOBIAN || k >= ZL_GAP) && problem->tapes[k].n_outputs)
            tape_prepare(&problem->tapes[k], m->registers[k], m->p);
    m->ready->prepared = 1;
}

/* The machine of a view, whose formulas are prepared when a run first needs them. */
static Machine machine_of_view(const zl_problem *problem, zl_run *run, zl_records *records,
                               long long view) {
    const zl_graph *graph = problem->graph;
    Machine m = machine_at(&graph->views[view], run, records,
                           numbers_at(problem, run) + graph->view_places[view]);
    m.graph = graph;
    m.settings = settings_at(run) + (graph->view_keys[view] & 31);
    if (!m.ready->prepared) prepare_formulas(&m, parameters_at(graph, run));
    return m;
}

/* The machine of the view that a run looks at. */
static Machine machine_of(const zl_problem *problem, zl_run *run, zl_records *records) {
    return machine_of_view(problem, run, records, run->graph.view);
}

static void evaluate_at(const Machine *m, int tape, const double *varying, double *outputs) {
    double *registers = m->registers[tape];
    if (!compiled_formula(m->problem, tape, registers, varying, outputs))
        tape_run(&m->problem->tapes[tape], registers, varying, outputs);
}

static double number_at(const Machine *m, int tape, const double *x) {
    double outputs[2];
    evaluate_at(m, tape, x, outputs);
    return outputs[0];
}

static double *estimate_of(const Machine *m, long long k) {
    return m->records->estimates + k * (ZL_ESTIMATE_WIDTH + 2 * m->problem->n_x);
}
