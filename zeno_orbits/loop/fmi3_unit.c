/* A unit: a run and what it has reached. The run is always an arc ahead of the communication point,
   since another guard may end an arc before its last steps, and states are dense output inside a step.
   So they do not depend on the communication points, unless a parameter or an input changes: then the
   run starts anew from the state reached. */

enum { PENDING = 64, ROOM = ZL_AT_ONCE(ZL_STOPS, ZL_GUARDS) + 2, ESTIMATES = 64 };

#define OFF_CIRCLE 1e-9 /* of a clock, as in model/numeric/admission.py */

/* Value references: time, states, parameters, then these. With several stops the last three follow for
   every stop. */
enum { MODE, IMPACTS, ZENO_POINTS, ZENO_TIME, OTHERS };

/* Where the run is inside of its last step, or on the way to a Zeno point. */
typedef struct {
    double start, end, unit, leg_start, offset, size;
    int mode, way, view;
    double before[ZL_MOST], after[ZL_MOST], coefficients[ZL_STAGES * ZL_MOST];
} Piece;

enum { NOWHERE, EXPLICIT, IMPLICIT, STRAIGHT };

typedef struct {
    double time;
    int kind, index;
} Happening;

/* What stays in one piece of memory without pointers, to be kept and taken again. */
typedef struct {
    int stage, begun, over, changed, n_pending, mode;
    double origin, time, stop, relative, state[ZL_MOST], zeno_time;
    long long closed, impacts, zeno_points, stop_impacts[ZL_STOPS], stop_zeno_points[ZL_STOPS];
    double zeno_times[ZL_STOPS];
    char given[sizeof MAY_CHANGE / sizeof MAY_CHANGE[0]]; /* parameters that were set */
    Happening pending[PENDING];
    Piece piece;
    /* Of the present arc with its steps: how many were passed, and steps and polynomials before it. */
    long long n_passed, first_step, first_polynomial;
    double arc[ZL_ARC_WIDTH + 2 * ZL_MOST];
} Reached;

typedef struct {
    Reached reached;
    zl_records records;
    zl_run *run;
    double *p;
    Log log;
    void *environment;
} Unit;

static const zl_problem *const problem = &PROBLEM_problem;

static size_t run_size(void) { return (size_t)zl_size(problem); }
static size_t p_size(void) { return (size_t)(problem->n_p + 1) * sizeof(double); }
static size_t estimates_size(long long n) {
    return (size_t)n * (size_t)(ZL_ESTIMATE_WIDTH + 2 * problem->n_x) * sizeof(double);
}

static size_t steps_size(long long n) {
    return (size_t)n * (size_t)(ZL_STEP_WIDTH + problem->n_x + 2) * sizeof(double);
}
static size_t polynomials_size(long long n) {
    return (size_t)n * (size_t)(ZL_STAGES * (problem->n_x + 2)) * sizeof(double);
}
static int number_of_stops(void) { return (int)problem->graph->n_stops; }

/* Which variable of a stop a reference means, if there are several stops; else MODE. */
static int of_stop(uint32_t ref, int *stop) {
    const long long place = (long long)ref - (1 + problem->n_x + problem->n_p + OTHERS);
    if (number_of_stops() < 2 || place < 0 || place >= 3 * number_of_stops()) return MODE;
    *stop = (int)(place / 3);
    return IMPACTS + (int)(place % 3);
}

static int fail(const Unit *unit, const char *text);

static int fail_at(const Unit *unit, const char *text, double time) {
    char line[160];
    sprintf(line, "%.100s at %.17g s", text, time);
    return fail(unit, line);
}

static int interrupted(const Unit *unit, int status) {
    static const char *const texts[] = {
        "The step size fell to rounding level",
        "The size of an implicit step fell to rounding level",
        "The flow is not finite",
        "The state leaves the admissible set",
        "The run took too many steps",
        "Impacts do not accumulate",
        "A coordinate is beyond its bound",
        "A velocity grows without end",
        "An impact does not close the gap",
        "The reset sends the state into the stop",
        "The machine has too many states",
        "A mode is missing",
        "The state is inside of a stop",
        "The motion slides along a switch",
        "Two events coincide",
        "A switch changes in every flight of impacts that accumulate",
        "Events of a switch come between impacts that accumulate",
        "Impacts accumulate on several stops in turn",
        "Events of a switch accumulate",
        "The guard of a switch is not a number",
        "The laws of contact do not determine the closed stops",
        "The reset of a switch sends the state into a stop",
        "A switch is armed at its start",
        "Switching times do not increase",
        "The restitution leaves [0, 1] at the speed of an impact",
        "Switches occur too often",
    };
    zl_detail detail;
    const char *text = "The run ended";
    if (status >= ZL_TOO_STIFF && status <= ZL_MANY_SWITCHES) text = texts[status - ZL_TOO_STIFF];
    zl_tell(unit->run, &detail);
    return fail_at(unit, text, unit->reached.origin + detail.time);
}

/* Restitution of the slowest impacts on a stop, as the law of impact has it. */
static double slow_restitution(const Unit *unit, int stop) {
    double approach = -SLOWEST, speed;
    long long view = 0;
    Machine m;
    while ((problem->graph->view_keys[view] & 31) != stop) view++;
    m = machine_of_view(problem, unit->run, 0, view);
    evaluate_at(&m, ZL_REBOUND, &approach, &speed);
    return speed / -approach;
}

static int is_in_range(uint32_t k, double value) {
    return LOWEST[k] <= value && value <= HIGHEST[k];
}

static int fail_in_range(const Unit *unit, uint32_t k, double value) {
    char line[200];
    sprintf(line, "%.60s must %.80s, but it is %.6g", PROBLEM_parameter_names[k], RANGES[k], value);
    return fail(unit, line);
}

/* Refuse a start off the circle of the clock, as `simulate` does. */
static int require_clock(const Unit *unit) {
    const double *x = unit->reached.state;
    char line[240];
    double cosine, sine;
    if (CLOCK[0] < 0) return OK;
    cosine = x[CLOCK[0]];
    sine = x[CLOCK[1]];
    if (fabs(cosine * cosine + sine * sine - 1.0) / 2.0 <= OFF_CIRCLE) return OK;
    sprintf(line, "%.60s and %.60s must be on the unit circle, as a clock, but they are %.6g and %.6g",
            PROBLEM_state_names[CLOCK[0]], PROBLEM_state_names[CLOCK[1]], cosine, sine);
    return fail(unit, line);
}

/* Refuse a parameter from which others are derived that were left as they are: `simulate` would
   derive them again, and this would be another machine. */
static int require_derived(const Unit *unit) {
    char line[240];
    int k;
    for (k = 0; DERIVED[k][0] >= 0; k++) {
        const int from = DERIVED[k][0], other = DERIVED[k][1];
        if (unit->p[from] == PROBLEM_parameters[from] || unit->reached.given[other]) continue;
        sprintf(line, "%.60s was set, and %.60s is derived from it: set that as well",
                PROBLEM_parameter_names[from], PROBLEM_parameter_names[other]);
        return fail(unit, line);
    }
    return OK;
}

/* Start the run from the state reached, with the parameters as they are. */
static int begin(Unit *unit) {
    Reached *reached = &unit->reached;
    zl_settings settings[ZL_STOPS];
    int k;
    if (require_derived(unit) != OK) return ERROR;
    for (k = 0; k < number_of_stops(); k++) {
        settings[k] = PROBLEM_settings[k];
        settings[k].records = 1;
        settings[k].until = reached->stop - reached->time;
        settings[k].absolute *= reached->relative / settings[k].relative;
        settings[k].relative = reached->relative;
    }
    zl_begin(problem, unit->run, settings, unit->p, reached->state);
    if (memcmp(unit->p, PROBLEM_parameters, (size_t)problem->n_p * sizeof(double)) != 0)
        for (k = 0; k < number_of_stops(); k++)
            settings_at(unit->run)[k].restitution = slow_restitution(unit, k);
    reached->origin = reached->time;
    reached->piece.way = NOWHERE;
    reached->piece.end = 0.0;
    reached->n_pending = reached->over = reached->changed = 0;
    reached->begun = 1;
    reached->n_passed = 0;
    reached->arc[8] = 0.0;
    return OK;
}

/* Give the estimates of a sequence of impacts more memory. */
static int more_estimates(Unit *unit) {
    zl_records *records = &unit->records;
    const long long n = 4 * records->most_estimates;
    double *more = realloc(records->estimates, estimates_size(n));
    if (!more) return 0;
    records->estimates = more;
    records->most_estimates = n;
    return 1;
}

/* Give the steps of an arc more memory. */
static int more_steps(Unit *unit, long long n) {
    zl_records *records = &unit->records;
    double *steps = realloc(records->steps, steps_size(n)), *polynomials;
    if (!steps) return 0;
    records->steps = steps;
    polynomials = realloc(records->polynomials, polynomials_size(n));
    if (!polynomials) return 0;
    records->polynomials = polynomials;
    records->most_steps = records->most_polynomials = n;
    return 1;
}

/* Keep the events that have just been recorded until the communication point reaches them. */
static void keep_events(Unit *unit) {
    Reached *reached = &unit->reached;
    const long long width = ZL_EVENT_WIDTH + 2 * problem->n_x;
    long long k;
    for (k = 0; k < unit->records.n_events && reached->n_pending < PENDING; k++) {
        const double *row = unit->records.events + k * width;
        reached->pending[reached->n_pending].kind = (int)row[0];
        reached->pending[reached->n_pending].index = (int)row[5];
        reached->pending[reached->n_pending].time = row[1];
        reached->n_pending++;
    }
}

/* Take the way to a Zeno point, which is an arc without steps. */
static void keep_tail(Unit *unit) {
    const double *arc = unit->records.arcs;
    Piece *piece = &unit->reached.piece;
    const size_t n_x = (size_t)problem->n_x;
    piece->way = STRAIGHT;
    piece->mode = ZL_FREE;
    piece->view = (int)arc[13];
    piece->start = arc[1];
    piece->end = arc[2];
    memcpy(piece->before, arc + ZL_ARC_WIDTH, n_x * sizeof(double));
    memcpy(piece->after, arc + ZL_ARC_WIDTH + n_x, n_x * sizeof(double));
}

/* Do the next thing of a run. */
static int advance(zl_run *run, zl_records *records) {
    Graph g;
    enter_graph(&g, problem, run, records);
    return advance_in_graph(&g);
}

/* Take the next step of the present arc; 0 if there is none. */
static int pass_step(Unit *unit) {
    Reached *reached = &unit->reached;
    Piece *piece = &reached->piece;
    const zl_records *records = &unit->records;
    const double *arc = reached->arc, *start = arc + ZL_ARC_WIDTH;
    const long long n_x = problem->n_x, width = ZL_STEP_WIDTH + n_x + 2;
    const long long n_steps = (long long)arc[8], k = reached->n_passed;
    const long long late = k - (n_steps - (long long)arc[10]);
    const int is_flight = (int)arc[0] == ZL_FLIGHT, is_last = k + 1 == n_steps;
    const double *row = records->steps + ((long long)arc[7] - reached->first_step + k) * width;
    if (k >= n_steps) return 0;
    reached->n_passed++;
    piece->way = late >= 0 ? IMPLICIT : EXPLICIT;
    piece->mode = (int)arc[0];
    piece->view = (int)arc[13];
    piece->unit = arc[3];
    piece->leg_start = arc[1];
    piece->offset = row[0];
    piece->size = row[1];
    piece->start = arc[1] + arc[3] * row[0];
    piece->end = is_last ? arc[2] : arc[1] + arc[3] * (row[0] + row[1]);
    if (k > 0) {
        memcpy(piece->before, row - width + ZL_STEP_WIDTH, (size_t)(n_x + 2) * sizeof(double));
    } else {
        memcpy(piece->before, start, (size_t)n_x * sizeof(double));
        piece->before[n_x] = arc[12];
        piece->before[n_x + 1] = arc[11];
    }
    memcpy(piece->after, is_last ? start + n_x : row + ZL_STEP_WIDTH, (size_t)n_x * sizeof(double));
    if (late >= 0)
        memcpy(piece->coefficients,
               records->polynomials + ((long long)arc[9] - reached->first_polynomial + late) *
                                          ZL_STAGES * (n_x + 2),
               (size_t)(ZL_STAGES * (n_x + (is_flight ? 2 : 0))) * sizeof(double));
    return 1;
}

static int carried_on(Unit *unit, int status);

/* Take the next piece of a run: a step of the present arc, or of the next. */
static int move_on(Unit *unit) {
    Reached *reached = &unit->reached;
    zl_records *records = &unit->records;
    if (!pass_step(unit)) {
        reached->piece.way = NOWHERE;
        records->n_steps = records->n_polynomials = records->n_arcs = 0;
        reached->first_step = unit->run->n_rows;
        reached->first_polynomial = unit->run->n_polynomials;
        while (!records->n_arcs && unit->run->stage != OVER) {
            int status;
            if (records->n_steps == records->most_steps && !more_steps(unit, 4 * records->most_steps))
                return fail(unit, "There is no memory");
            records->n_events = 0;
            status = carried_on(unit, advance(unit->run, records));
            if (status != OK) return status;
        }
        if (records->n_arcs) {
            const size_t bytes = (size_t)(ZL_ARC_WIDTH + 2 * problem->n_x + 2) * sizeof(double);
            memcpy(reached->arc, records->arcs, bytes);
            reached->n_passed = 0;
            if (!pass_step(unit)) keep_tail(unit);
        }
    }
    reached->over = unit->run->stage == OVER && reached->n_passed >= (long long)reached->arc[8];
    return OK;
}

/* See to what a run needs after its next thing, and to its events. */
static int carried_on(Unit *unit, int status) {
    if (status == ZL_ESTIMATES) return more_estimates(unit) ? OK : fail(unit, "There is no memory");
    if (status == ZL_CURVE) {
        /* Impacts are followed one by one. */
        zl_answer(unit->run, 0, 0.0, 0.0, PROBLEM_settings[0].sizes);
        return OK;
    }
    if (status != GO_ON) return interrupted(unit, status);
    keep_events(unit);
    return OK;
}

/* The state at a time of the run inside the last piece. */
static void state_inside_piece(Unit *unit, double time, double *state) {
    const Piece *piece = &unit->reached.piece;
    const int n = (int)problem->n_x, n_y = n + (piece->mode == ZL_FLIGHT ? 2 : 0);
    const double offset = (time - piece->leg_start) / piece->unit - piece->offset;
    long long view;
    double y[ZL_MOST];
    int i;
    if (time >= piece->end) {
        memcpy(state, piece->after, (size_t)n * sizeof(double));
        return;
    }
    if (piece->way == STRAIGHT) {
        const double part = (time - piece->start) / (piece->end - piece->start);
        for (i = 0; i < n; i++)
            state[i] = piece->before[i] + part * (piece->after[i] - piece->before[i]);
        return;
    }
    if (piece->way == IMPLICIT) {
        polynomial_at(piece->coefficients, n_y, offset / piece->size, y);
        for (i = 0; i < n; i++) state[i] = piece->before[i] + y[i];
        return;
    }
    view = unit->run->graph.view;
    unit->run->graph.view = piece->view;
    zl_states_at(problem, unit->run, piece->mode, piece->unit, piece->before, &offset, 1, y);
    unit->run->graph.view = view;
    memcpy(state, y, (size_t)n * sizeof(double));
}

/* Count the events up to a time of the run. */
static void pass_events(Reached *reached, double time) {
    int k, left = 0;
    for (k = 0; k < reached->n_pending; k++) {
        const Happening one = reached->pending[k];
        if (one.time > time) {
            reached->pending[left++] = one;
            continue;
        }
        reached->impacts += one.kind == ZL_IMPACT;
        reached->zeno_points += one.kind == ZL_ZENO;
        if (one.kind == ZL_IMPACT) reached->stop_impacts[one.index]++;
        if (one.kind != ZL_ZENO) continue;
        reached->stop_zeno_points[one.index]++;
        reached->zeno_time = reached->zeno_times[one.index] = reached->origin + one.time;
    }
    reached->n_pending = left;
}

/* The closed stops of a piece, as bits. */
static long long closed_in(const Piece *piece) {
    const int on_stop = piece->mode == ZL_LOCKED;
    const long long key = problem->graph->view_keys[piece->view];
    return (key >> 5 & (BIT(ZL_STOPS) - 1)) | (on_stop ? BIT(key & 31) : 0);
}

/* Bring the state to a time. */
static int go_to(Unit *unit, double target) {
    Reached *reached = &unit->reached;
    Piece *piece = &reached->piece;
    double time;
    if ((reached->changed || !reached->begun) && begin(unit) != OK) return ERROR;
    time = target - reached->origin;
    while (!reached->over && (piece->way == NOWHERE || piece->end <= time)) {
        int status = move_on(unit);
        if (status != OK) return status;
        /* Events of what has passed make place for others. */
        if (piece->way != NOWHERE && piece->end <= time) pass_events(reached, piece->end);
    }
    pass_events(reached, time);
    state_inside_piece(unit, time, reached->state);
    reached->closed = closed_in(piece);
    reached->mode = (int)reached->closed;
    reached->time = target;
    return OK;
}
