/* Derivatives along a recorded execution, as `sensitivity` and `state_transition` in Python have
   them: directions as lanes, carried along the accepted steps and through every event. */

enum { T_STAGES = 12 }; /* of DOP853 */

#define T_PIVOT 0.01
/* Part of the largest entry of a column that a pivot has at least. */

/* Rows of a shift before those of the states. */
enum { T_TIME, T_RATE, T_STATE };

typedef struct {
    Machine m;
    const zl_tangent *tangent;
    const zl_track *track;
    long long n_x, n_k, m_columns, width; /* states, parameters, columns, and those with zeros */
    int mode, n;                          /* of the arc */
    double *registers[ZL_SLOPES], *lanes[ZL_MODES], *values; /* entries at every stage */
    double *q, *before, *after, *sum, *slopes, *stages, *matrix, *outputs;
} Tangent;

/* Take memory; without a start only its size is found. */
static double *taken(double **place, long long n) {
    double *start = *place;
    *place += n;
    return start;
}

static long long largest_entries(const zl_tangent *tangent) {
    long long k, most = 1;
    for (k = 0; k < ZL_SLOPES; k++)
        if (tangent->tapes[k].n_outputs > most) most = tangent->tapes[k].n_outputs;
    return most;
}

/* Length of a row of the linear system of an implicit step: the stages of one state after those of
   another, ZL_LANES each, and the right sides. */
static long long system_width(long long n, long long width) { return n * ZL_LANES + width; }

long long zl_tangent_work(const zl_problem *problem, const zl_tangent *tangent) {
    const long long n_y = problem->n_x + 2, columns = problem->n_x + tangent->n_chosen;
    const long long width = (columns + ZL_LANES - 1) / ZL_LANES * ZL_LANES;
    const long long most = largest_entries(tangent);
    long long k, n = 0;
    for (k = 0; k < ZL_SLOPES; k++) n += tangent->tapes[k].n_registers;
    for (k = 0; k < ZL_MODES; k++) n += tangent->tapes[ZL_LINEAR + k].n_registers * ZL_LANES;
    n += T_STAGES * most + most;                     /* values, outputs */
    n += (tangent->n_chosen + 1) * width;            /* q */
    n += (3 + T_STAGES + ZL_STAGES) * n_y * width;   /* before, after, sum, slopes, stages */
    n += ZL_STAGES * n_y * system_width(n_y, width); /* matrix */
    return n;
}

static Tangent tangent_of(const zl_problem *problem, const zl_tangent *tangent, zl_run *run,
                          const zl_track *track, zl_records *records) {
    Tangent t;
    double *place = track->work;
    const long long n_y = problem->n_x + 2, most = largest_entries(tangent);
    int k;
    t.m = machine_of(problem, run, records);
    t.tangent = tangent;
    t.track = track;
    t.n_x = problem->n_x;
    t.n_k = tangent->n_chosen;
    t.m_columns = t.n_x + t.n_k;
    t.width = (t.m_columns + ZL_LANES - 1) / ZL_LANES * ZL_LANES;
    for (k = 0; k < ZL_SLOPES; k++)
        t.registers[k] = taken(&place, tangent->tapes[k].n_registers);
    for (k = 0; k < ZL_MODES; k++)
        t.lanes[k] = taken(&place, tangent->tapes[ZL_LINEAR + k].n_registers * ZL_LANES);
    t.values = taken(&place, T_STAGES * most);
    t.outputs = taken(&place, most);
    t.q = taken(&place, (t.n_k + 1) * t.width);
    t.before = taken(&place, n_y * t.width);
    t.after = taken(&place, n_y * t.width);
    t.sum = taken(&place, n_y * t.width);
    t.slopes = taken(&place, T_STAGES * n_y * t.width);
    t.stages = taken(&place, ZL_STAGES * n_y * t.width);
    t.matrix = place;
    t.mode = ZL_FREE;
    t.n = (int)t.n_x;
    return t;
}

static void prepare_slopes(const Tangent *t, int tape) {
    const zl_tape *one = &t->tangent->tapes[tape];
    tape_prepare(one, t->registers[tape], t->m.p);
    if (tape < ZL_MODES) tape_spread(one, t->registers[tape], t->lanes[tape]);
}

static void prepare_all(const Tangent *t) {
    int k;
    for (k = 0; k < ZL_SLOPES; k++)
        if (k != ZL_LINEAR + ZL_FLIGHT) prepare_slopes(t, k);
}

/* Add a multiple of rows of lanes. Mostly one row of lanes holds all columns. */
ALWAYS_INLINE void add_row(double *restrict to, const double *restrict from, double factor,
                           long long width) {
    long long k;
    int lane;
    if (width == ZL_LANES)
        for (lane = 0; lane < ZL_LANES; lane++) to[lane] += factor * from[lane];
    else
        for (k = 0; k < width; k += ZL_LANES)
            for (lane = 0; lane < ZL_LANES; lane++) to[k + lane] += factor * from[k + lane];
}

static void set_row(double *to, const double *from, double factor, long long width) {
    long long k;
    int lane;
    for (k = 0; k < width; k += ZL_LANES)
        for (lane = 0; lane < ZL_LANES; lane++) to[k + lane] = factor * from[k + lane];
}

static void clear_rows(double *to, long long n) { memset(to, 0, (size_t)n * sizeof(double)); }

static void copy_rows(double *to, const double *from, long long n) {
    memcpy(to, from, (size_t)n * sizeof(double));
}

/* The entries of the variational equation at several states, those of one after the other. */
static void entries_at(const Tangent *t, const double *states, int count) {
    const zl_tape *tape = &t->tangent->tapes[ZL_LINEAR + t->mode];
    double *lanes = t->lanes[t->mode];
    int first, lane, i;
    long long e;
    for (first = 0; first < count; first += ZL_LANES) {
        for (lane = 0; lane < ZL_LANES; lane++) {
            const double *y = states + (first + lane < count ? first + lane : first) * ZL_MOST;
            for (i = 0; i < t->n; i++) lanes[i * ZL_LANES + lane] = y[i];
        }
        carry_out_lanes(tape->code + tape->n_once, tape->n_instructions - tape->n_once, lanes,
                        tape->tables);
        for (lane = 0; lane < ZL_LANES && first + lane < count; lane++) {
            double *values = t->values + (first + lane) * tape->n_outputs;
            for (e = 0; e < tape->n_outputs; e++)
                values[e] = lanes[(long long)tape->outputs[e] * ZL_LANES + lane];
        }
    }
}

static const double *entries_of(const Tangent *t, int stage) {
    return t->values + stage * t->tangent->tapes[ZL_LINEAR + t->mode].n_outputs;
}

/* (J, F) of a stage times perturbations of state and parameters, in the rows that have a place.
   Entries are ordered by rows. */
static void varied(const Tangent *t, int stage, const int *place, const double *v, double *to) {
    const int *rows = t->tangent->rows[t->mode], *columns = t->tangent->columns[t->mode];
    const long long n_entries = t->tangent->tapes[ZL_LINEAR + t->mode].n_outputs, width = t->width;
    const double *values = entries_of(t, stage);
    long long first = 0, last, e, k;
    int row, lane;
    for (row = 0; row < t->n; row++, first = last) {
        for (last = first; last < n_entries && rows[last] == row; last++) continue;
        if (place[row] < 0) continue;
        for (k = 0; k < width; k += ZL_LANES) {
            double sum[ZL_LANES] = {0.0};
            for (e = first; e < last; e++) {
                const int column = columns[e];
                const double *from = column < t->n ? v + column * width + k
                                                   : t->q + (column - t->n) * width + k;
                for (lane = 0; lane < ZL_LANES; lane++) sum[lane] += values[e] * from[lane];
            }
            for (lane = 0; lane < ZL_LANES; lane++) to[row * width + k + lane] = sum[lane];
        }
    }
}

static double *slope_of(const Tangent *t, int stage) {
    return t->slopes + stage * (t->n_x + 2) * t->width;
}

/* Perturbations and a sum of their slopes; without perturbations the sum alone. */
static void sum_slopes(const Tangent *t, const Row *row, double size, const double *v, double *to) {
    const long long all = t->n * t->width;
    double weights[12];
    const double *slopes[12];
    long long k;
    int j, lane;
    for (j = 0; j < row->n; j++) {
        weights[j] = size * row->weights[j];
        slopes[j] = slope_of(t, row->slopes[j]);
    }
    for (k = 0; k < all; k += ZL_LANES) {
        double sum[ZL_LANES] = {0.0};
        if (v)
            for (lane = 0; lane < ZL_LANES; lane++) sum[lane] = v[k + lane];
        for (j = 0; j < row->n; j++)
            for (lane = 0; lane < ZL_LANES; lane++) sum[lane] += weights[j] * slopes[j][k + lane];
        for (lane = 0; lane < ZL_LANES; lane++) to[k + lane] = sum[lane];
    }
}

/* The largest error of a column, in parts of the column; NaN if it is not known. */
static double relative_error(const Tangent *t, const double *error, const double *after) {
    double largest = 0.0;
    long long k;
    int i;
    for (k = 0; k < t->m_columns; k++) {
        double wrong = 0.0, size = 0.0;
        for (i = 0; i < t->n; i++) {
            const double a = fabs(error[i * t->width + k]), b = fabs(after[i * t->width + k]);
            if (isnan(a) || isnan(b)) return NAN;
            wrong = greater(wrong, a);
            size = greater(size, b);
        }
        /* A column that vanishes has no error. */
        if (size > 0.0) largest = greater(largest, wrong / size);
    }
    return largest;
}

/* Perturbations after an explicit step, and their relative error. */
static double explicit_tangent(const Tangent *t, const double *y, double size, const double *v,
                               double *after) {
    double slopes[T_STAGES][ZL_MOST], states[T_STAGES * ZL_MOST], end[ZL_MOST];
    int every[ZL_MOST] = {0}, i, stage;
    rate_at(&t->m, y, slopes[0]);
    explicit_state(&t->m, y, size, slopes, end);
    memcpy(states, y, (size_t)t->n * sizeof(double));
    for (stage = 1; stage < T_STAGES; stage++) {
        double *state = states + stage * ZL_MOST;
        combine_slopes(&STAGES[stage - 1], slopes, t->n, state);
        for (i = 0; i < t->n; i++) state[i] = y[i] + size * state[i];
    }
    entries_at(t, states, T_STAGES);
    varied(t, 0, every, v, slope_of(t, 0));
    for (stage = 1; stage < T_STAGES; stage++) {
        sum_slopes(t, &STAGES[stage - 1], size, v, t->sum);
        varied(t, stage, every, t->sum, slope_of(t, stage));
    }
    sum_slopes(t, &STEP, size, v, after);
    sum_slopes(t, &FIFTH, size, 0, t->sum);
    return relative_error(t, t->sum, after);
}

/* A linear system: the stages of states that depend on each other in a circle, state after state.
   Of every row it is known for which states it has entries. */
typedef struct {
    double *rows;
    long long row_width, width;
    int n; /* states */
    unsigned long long entries[ZL_STAGES * ZL_MOST];
} System;

static double *right_of(const System *system, int row) {
    return system->rows + (row + 1) * system->row_width - system->width;
}

/* Choose a pivot: the diagonal unless another row has one that is larger by far. So the equations of
   positions, which hold little, stay first. */
static void exchange(System *system, int k, int column) {
    double *rows = system->rows, kept;
    const long long row_width = system->row_width;
    unsigned long long entries;
    int pivot = k, i;
    long long j;
    for (i = k + 1; i < ZL_STAGES * system->n; i++)
        if (fabs(rows[i * row_width + column]) > fabs(rows[pivot * row_width + column])) pivot = i;
    if (fabs(rows[k * row_width + column]) >= T_PIVOT * fabs(rows[pivot * row_width + column]))
        return;
    for (j = 0; j < row_width; j++) {
        kept = rows[k * row_width + j];
        rows[k * row_width + j] = rows[pivot * row_width + j];
        rows[pivot * row_width + j] = kept;
    }
    entries = system->entries[k];
    system->entries[k] = system->entries[pivot];
    system->entries[pivot] = entries;
}

/* Solve it by Gauss; the right sides become the solution. */
static void solve_system(System *system) {
    const long long row_width = system->row_width, width = system->width;
    const int n = ZL_STAGES * system->n;
    int i, k, block;
    for (k = 0; k < n; k++) {
        const int state = k / ZL_STAGES, column = state * ZL_LANES + k % ZL_STAGES;
        double *row = system->rows + k * row_width, inverse;
        exchange(system, k, column);
        inverse = 1.0 / row[column];
        for (i = k + 1; i < n; i++) {
            double *other = system->rows + i * row_width, factor = other[column];
            if (factor == 0.0) continue;
            factor *= -inverse;
            for (block = state; block < system->n; block++)
                if (system->entries[k] >> block & 1)
                    add_row(other + block * ZL_LANES, row + block * ZL_LANES, factor, ZL_LANES);
            add_row(right_of(system, i), right_of(system, k), factor, width);
            system->entries[i] |= system->entries[k];
        }
    }
    for (k = n - 1; k >= 0; k--) {
        const int state = k / ZL_STAGES, column = state * ZL_LANES + k % ZL_STAGES;
        double *right = right_of(system, k), *row = system->rows + k * row_width;
        for (i = k + 1; i < n; i++) {
            const double entry = row[i / ZL_STAGES * ZL_LANES + i % ZL_STAGES];
            if (entry != 0.0) add_row(right, right_of(system, i), -entry, width);
        }
        set_row(right, right, 1.0 / row[column], width);
    }
}

/* Write the matrix of one block of states, 1 - size A x J; 1 if J has a part in it. */
static int block_matrix(const Tangent *t, const int *place, double size, System *system) {
    const int *rows = t->tangent->rows[t->mode], *columns = t->tangent->columns[t->mode];
    const long long n_entries = t->tangent->tapes[ZL_LINEAR + t->mode].n_outputs;
    int i, j, k, coupled = 0;
    long long e;
    clear_rows(system->rows, ZL_STAGES * system->n * system->row_width);
    for (k = 0; k < system->n; k++)
        for (i = 0; i < ZL_STAGES; i++) {
            system->rows[(k * ZL_STAGES + i) * system->row_width + k * ZL_LANES + i] = 1.0;
            system->entries[k * ZL_STAGES + i] = 1ULL << k;
        }
    for (e = 0; e < n_entries; e++) {
        const int row = place[rows[e]], column = columns[e] < t->n ? place[columns[e]] : -1;
        if (row < 0 || column < 0) continue;
        coupled = 1;
        for (i = 0; i < ZL_STAGES; i++) {
            const int to = row * ZL_STAGES + i;
            double *entries = system->rows + to * system->row_width + column * ZL_LANES;
            system->entries[to] |= 1ULL << column;
            for (j = 0; j < ZL_STAGES; j++)
                entries[j] -= size * t->tangent->matrix[i * ZL_STAGES + j] * entries_of(t, j)[e];
        }
    }
    return coupled;
}

/* Add the stages of one block to the perturbations there; what its states depend on is known. */
static void solve_block(const Tangent *t, const int *members, int n, double size) {
    const long long stage = t->n * t->width;
    int place[ZL_MOST], coupled, i, j, k;
    System system;
    system.rows = t->matrix;
    system.row_width = system_width(n, t->width);
    system.width = t->width;
    system.n = n;
    for (i = 0; i < t->n; i++) place[i] = -1;
    for (k = 0; k < n; k++) place[members[k]] = k;
    coupled = block_matrix(t, place, size, &system);
    for (i = 0; i < ZL_STAGES; i++) varied(t, i, place, t->stages + i * stage, slope_of(t, i));
    for (k = 0; k < n; k++)
        for (i = 0; i < ZL_STAGES; i++)
            for (j = 0; j < ZL_STAGES; j++)
                add_row(right_of(&system, k * ZL_STAGES + i), slope_of(t, j) + members[k] * t->width,
                        size * t->tangent->matrix[i * ZL_STAGES + j], t->width);
    if (coupled) solve_system(&system);
    for (k = 0; k < n; k++)
        for (i = 0; i < ZL_STAGES; i++)
            add_row(t->stages + i * stage + members[k] * t->width,
                    right_of(&system, k * ZL_STAGES + i), 1.0, t->width);
}

/* Perturbations after a step of Radau IIA along the states at its stages, block after block. */
static void implicit_tangent(const Tangent *t, const double *states, double size, const double *v,
                             double *after) {
    const int *members = t->tangent->states[t->mode], *ends = t->tangent->ends[t->mode];
    const long long stage = t->n * t->width;
    int block, begin = 0, i;
    entries_at(t, states, ZL_STAGES);
    for (i = 0; i < ZL_STAGES; i++) copy_rows(t->stages + i * stage, v, stage);
    for (block = 0; block < t->tangent->n_blocks[t->mode]; block++) {
        solve_block(t, members + begin, ends[block] - begin, size);
        begin = ends[block];
    }
    copy_rows(after, t->stages + (ZL_STAGES - 1) * stage, stage);
}

/* The states at the stages of a part of an explicit step. */
static void explicit_stages(const Tangent *t, const double *y, double size, double *states) {
    double slopes[T_STAGES][ZL_MOST];
    int k;
    rate_at(&t->m, y, slopes[0]);
    for (k = 0; k < ZL_STAGES; k++)
        explicit_state(&t->m, y, size * t->m.problem->scheme->nodes[k], slopes,
                       states + k * ZL_MOST);
}

/* The same of an implicit step, from its polynomial. */
static void implicit_stages(const Tangent *t, const double *y, double part,
                            const double *coefficients, double *states) {
    int i, k;
    for (k = 0; k < ZL_STAGES; k++) {
        double *state = states + k * ZL_MOST;
        polynomial_at(coefficients, t->n, part * t->m.problem->scheme->nodes[k], state);
        for (i = 0; i < t->n; i++) state[i] += y[i];
    }
}

/* A recorded step: state before it, size, and its polynomial if it is implicit. */
typedef struct {
    double start, size;
    const double *before, *coefficients;
} Recorded;

/* Perturbations after a part of a step. */
static void step_tangent(const Tangent *t, const Recorded *step, double size, const double *v,
                         double *after) {
    double states[ZL_STAGES * ZL_MOST];
    if (step->coefficients)
        implicit_stages(t, step->before, size / step->size, step->coefficients, states);
    else {
        if (explicit_tangent(t, step->before, size, v, after) <= t->track->trusted) return;
        /* The state, on its slow manifold, does not feel a fast perturbation grow. */
        explicit_stages(t, step->before, size, states);
    }
    implicit_tangent(t, states, size, v, after);
}

static const double *arc_row(const Tangent *t, long long arc) {
    return t->track->arcs + arc * (ZL_ARC_WIDTH + 2 * t->n_x + 2);
}

/* Take the mode of an arc. */
static void enter_arc(Tangent *t, long long arc) {
    const double *row = arc_row(t, arc);
    Leg kept;
    t->mode = (int)row[0];
    t->n = (int)t->n_x + (t->mode == ZL_FLIGHT ? 2 : 0);
    enter(&t->m, t->mode, row[3], &kept);
    if (t->mode == ZL_FLIGHT) prepare_slopes(t, ZL_LINEAR + ZL_FLIGHT);
}

/* Carry the perturbations in `before` along an arc; they end there, too. */
static void carry(Tangent *t, long long arc, int parts, double *times, double *rows) {
    const double *row = arc_row(t, arc);
    const long long n_x = t->n_x, first = (long long)row[7], n_steps = (long long)row[8];
    const long long polynomial = (long long)row[9], n_polynomials = (long long)row[10];
    const long long all = t->n * t->width;
    double begin[ZL_MOST];
    Recorded step;
    long long k;
    int part;
    memcpy(begin, row + ZL_ARC_WIDTH, (size_t)n_x * sizeof(double));
    begin[n_x] = row[12];
    begin[n_x + 1] = row[11];
    step.before = begin;
    for (k = 0; k < n_steps; k++) {
        const double *record = t->track->steps + (first + k) * (ZL_STEP_WIDTH + n_x + 2);
        const long long implicit = k - (n_steps - n_polynomials);
        double whole, *kept;
        step.start = record[0];
        step.size = record[1];
        step.coefficients = 0;
        if (implicit >= 0)
            step.coefficients = t->track->polynomials +
                                (polynomial + implicit) * ZL_STAGES * (n_x + 2);
        whole = lesser(step.size, row[4] - step.start);
        for (part = 1; part <= parts; part++) {
            const double size = whole * part / parts;
            step_tangent(t, &step, size, t->before, t->after);
            if (!times) continue;
            *times++ = step.start + size;
            copy_rows(rows, t->after, all);
            rows += all;
        }
        kept = t->before;
        t->before = t->after;
        t->after = kept;
        step.before = record + ZL_STEP_WIDTH;
    }
}

void zl_course(const zl_problem *problem, const zl_tangent *tangent, zl_run *run,
               const zl_track *track, int parts, const double *v, const double *q, double *times,
               double *rows) {
    Tangent t = tangent_of(problem, tangent, run, track, 0);
    prepare_all(&t);
    enter_arc(&t, 0);
    copy_rows(t.before, v, t.n * t.width);
    copy_rows(t.q, q, (t.n_k + (t.mode == ZL_FLIGHT ? 1 : 0)) * t.width);
    carry(&t, 0, parts, times, rows);
}

/* Derivatives of a formula at a state, by columns; their number of rows is given. */
static const double *slopes_at(const Tangent *t, int tape, const double *varying) {
    tape_run(&t->tangent->tapes[tape], t->registers[tape], varying, t->outputs);
    return t->outputs;
}

/* The change of one row of a formula, by perturbations of the state and of the parameters. */
static void total(const Tangent *t, const double *slopes, int n_rows, int row, const double *state,
                  double *to) {
    long long k;
    clear_rows(to, t->width);
    for (k = 0; k < t->n_x; k++)
        add_row(to, state + k * t->width, slopes[k * n_rows + row], t->width);
    for (k = 0; k < t->n_k; k++) to[t->n_x + k] += slopes[(t->n_x + k) * n_rows + row];
}

/* How far an event is delayed: a guard's change over minus its rate. */
static void delayed(const Tangent *t, const double *change, double rate, double *delay) {
    long long k;
    for (k = 0; k < t->width; k++) delay[k] = -change[k] / rate;
}

enum { C_GAP, C_RATE, C_LIFT, C_MULTIPLIER, C_PULL, C_ROWS };

/* The impact at the end of a flight in the free mode. */
static void flown_free(Tangent *t, long long arc, const double *start, double *end) {
    const double *x = arc_row(t, arc) + ZL_ARC_WIDTH + t->n_x;
    const double *slopes;
    double gap[2], rate[ZL_MOST], *delay = t->sum;
    long long i;
    carry(t, arc, 1, 0, 0);
    slopes = slopes_at(t, ZL_CONTACT_SLOPES, x);
    evaluate_at(&t->m, ZL_GAP, x, gap);
    rate_at(&t->m, x, rate);
    total(t, slopes, C_ROWS, C_GAP, t->before, end + T_TIME * t->width);
    delayed(t, end + T_TIME * t->width, gap[1], delay);
    for (i = 0; i < t->n_x; i++) {
        double *to = end + (T_STATE + i) * t->width;
        copy_rows(to, t->before + i * t->width, t->width);
        add_row(to, delay, rate[i], t->width);
    }
    copy_rows(end + T_TIME * t->width, start + T_TIME * t->width, t->width);
    add_row(end + T_TIME * t->width, delay, 1.0, t->width);
    total(t, slopes, C_ROWS, C_RATE, end + T_STATE * t->width, end + T_RATE * t->width);
}

/* The same in rescaled time: the speed is a parameter that moves, too. */
static void flown_rescaled(Tangent *t, long long arc, const double *start, double *end) {
    const double *row = arc_row(t, arc), *y = row + ZL_ARC_WIDTH + t->n_x;
    const double *by_rate = start + T_RATE * t->width;
    const double speed = row[3], duration = row[4];
    double rate[ZL_MOST], *delay = t->sum, *time = end + T_TIME * t->width;
    double *gap_rate = end + T_RATE * t->width;
    long long i;
    carry(t, arc, 1, 0, 0);
    rate_at(&t->m, y, rate);
    delayed(t, t->before + t->n_x * t->width, y[t->n_x + 1], delay);
    for (i = 0; i < t->n_x; i++) {
        double *to = end + (T_STATE + i) * t->width;
        copy_rows(to, t->before + i * t->width, t->width);
        add_row(to, delay, rate[i], t->width);
    }
    copy_rows(time, start + T_TIME * t->width, t->width);
    add_row(time, by_rate, duration, t->width);
    add_row(time, delay, speed, t->width);
    set_row(gap_rate, by_rate, y[t->n_x + 1], t->width);
    add_row(gap_rate, t->before + (t->n_x + 1) * t->width, speed, t->width);
    add_row(gap_rate, delay, speed * rate[t->n_x + 1], t->width);
}

/* The state and the gap rate after an impact. */
static void struck(const Tangent *t, const double *event, const double *before, double *after) {
    const long long n = t->n_x;
    double given[ZL_MOST + 1], *to = after + T_RATE * t->width;
    const double *slopes;
    long long i, k;
    memcpy(given, event + ZL_EVENT_WIDTH, (size_t)n * sizeof(double));
    given[n] = event[2];
    slopes = slopes_at(t, ZL_RESET_SLOPES, given);
    copy_rows(after + T_TIME * t->width, before + T_TIME * t->width, t->width);
    for (i = 0; i < n; i++) {
        double *state = after + (T_STATE + i) * t->width;
        clear_rows(state, t->width);
        for (k = 0; k < n; k++)
            add_row(state, before + (T_STATE + k) * t->width, slopes[k * n + i], t->width);
        add_row(state, before + T_RATE * t->width, slopes[n * n + i], t->width);
        for (k = 0; k < t->n_k; k++) state[n + k] += slopes[(n + 1 + k) * n + i];
    }
    slopes = slopes_at(t, ZL_REBOUND_SLOPES, given + n);
    set_row(to, before + T_RATE * t->width, slopes[0], t->width);
    for (k = 0; k < t->n_k; k++) to[n + k] += slopes[1 + k];
}

/* Move a state onto the stop, and its shift with it. */
static void rested(const Tangent *t, const double *x, double *shift) {
    const double *slopes = slopes_at(t, ZL_RESTING_SLOPES, x);
    const int n_rows = (int)(2 * t->n_x + 1);
    int i;
    for (i = 0; i < t->n_x; i++)
        total(t, slopes, n_rows, i, shift + T_STATE * t->width, t->slopes + i * t->width);
    copy_rows(shift + T_STATE * t->width, t->slopes, t->n_x * t->width);
    clear_rows(shift + T_RATE * t->width, t->width);
}

/* The release at the end of a locked arc. */
static void released(Tangent *t, long long arc, const double *start, double *end) {
    const double *x = arc_row(t, arc) + ZL_ARC_WIDTH + t->n_x;
    double rate[ZL_MOST], *delay = t->sum, *time = end + T_TIME * t->width;
    long long i;
    carry(t, arc, 1, 0, 0);
    rate_at(&t->m, x, rate);
    total(t, slopes_at(t, ZL_CONTACT_SLOPES, x), C_ROWS, C_MULTIPLIER, t->before, time);
    delayed(t, time, number_at(&t->m, ZL_PULL, x), delay);
    for (i = 0; i < t->n_x; i++) {
        double *to = end + (T_STATE + i) * t->width;
        copy_rows(to, t->before + i * t->width, t->width);
        add_row(to, delay, rate[i], t->width);
    }
    copy_rows(time, start + T_TIME * t->width, t->width);
    add_row(time, delay, 1.0, t->width);
    rested(t, x, end);
}

/* The end of an arc at a time that stays as it is. */
static void stopped(Tangent *t, long long arc, const double *start, double *end) {
    const double *row = arc_row(t, arc), *y = row + ZL_ARC_WIDTH + t->n_x;
    const double unit = row[3], duration = row[4];
    double rate[ZL_MOST], *delay = t->sum, *gap_rate = end + T_RATE * t->width;
    long long i;
    carry(t, arc, 1, 0, 0);
    rate_at(&t->m, y, rate);
    set_row(delay, start + T_TIME * t->width, -1.0 / unit, t->width);
    if (t->mode == ZL_FLIGHT)
        add_row(delay, start + T_RATE * t->width, -duration / unit, t->width);
    clear_rows(end, (T_STATE + t->n_x) * t->width);
    for (i = 0; i < t->n_x; i++) {
        double *to = end + (T_STATE + i) * t->width;
        copy_rows(to, t->before + i * t->width, t->width);
        add_row(to, delay, rate[i], t->width);
    }
    if (t->mode != ZL_LOCKED)
        total(t, slopes_at(t, ZL_CONTACT_SLOPES, y), C_ROWS, C_RATE, end + T_STATE * t->width,
              gap_rate);
}

/* A shift of an arc: 0 of its start, 1 of its end, 2 of what follows. What comes before the first
   arc has one, too. */
static double *shift_of(const Tangent *t, double *shifts, long long arc, int which) {
    return shifts + (3 * (arc + 1) + which) * (T_STATE + t->n_x) * t->width;
}

/* Join an impact to its sequence, or begin a new one. */
static void joined(const Tangent *t, double time, const double *event) {
    zl_run *run = t->m.run;
    zl_start *start = &run->start;
    const size_t bytes = (size_t)t->n_x * sizeof(double);
    double outputs[2 * ZL_MOST + 1];
    evaluate_at(&t->m, ZL_REBOUND, event + 2, &start->speed);
    evaluate_at(&t->m, ZL_RESTING, event + ZL_EVENT_WIDTH + t->n_x, outputs);
    start->time = time;
    start->lift = outputs[t->n_x];
    memcpy(start->resting, outputs, bytes);
    memcpy(start->rate, outputs + t->n_x + 1, bytes);
    if (run->pace.n_estimates && start->speed >= speed_of(&t->m, run->pace.n_estimates - 1))
        run->pace.n_estimates = 0;
    if (!add_estimate(&t->m, 0)) run->pace.n_estimates = 0;
}

/* How the first-order Zeno point of an impact moves: time, nothing, state. */
static void tail(const Tangent *t, const double *x, double speed, const double *shift, double *to) {
    const double e = t->m.run->settings.restitution;
    const int n_rows = (int)(2 * t->n_x + 1);
    const double *slopes = slopes_at(t, ZL_RESTING_SLOPES, x);
    double resting[2 * ZL_MOST + 1], unit, remaining, *longer = to + T_TIME * t->width;
    double *moved = t->stages;
    long long i, k;
    evaluate_at(&t->m, ZL_RESTING, x, resting);
    unit = 2.0 / (-resting[t->n_x] * (1 - e));
    remaining = unit * speed;
    for (i = 0; i < n_rows; i++)
        total(t, slopes, n_rows, (int)i, shift + T_STATE * t->width, moved + i * t->width);
    set_row(longer, shift + T_RATE * t->width, unit, t->width);
    for (k = 0; k < t->n_k; k++)
        longer[t->n_x + k] += remaining * (t->track->restitution[k] / (1 - e));
    add_row(longer, moved + t->n_x * t->width, -remaining / resting[t->n_x], t->width);
    for (i = 0; i < t->n_x; i++) {
        double *state = to + (T_STATE + i) * t->width;
        copy_rows(state, moved + i * t->width, t->width);
        add_row(state, longer, resting[t->n_x + 1 + i], t->width);
        add_row(state, moved + (t->n_x + 1 + i) * t->width, remaining, t->width);
    }
    add_row(longer, shift + T_TIME * t->width, 1.0, t->width);
}

/* Add how the weights of an extrapolation move with the speeds of its nodes. */
static void reweighted(const Tangent *t, const long long *nodes, int n, const double *speeds,
                       const double *weights, const double *const *shifts, double *to) {
    const double *last = estimate_of(&t->m, nodes[0]);
    double *change = t->sum, total_share = 0.0;
    int i, j, k;
    for (k = 0; k < n; k++) total_share += speeds[n - 1] / speeds[k];
    for (k = 0; k < n; k++) {
        const double *estimate = estimate_of(&t->m, nodes[n - 1 - k]);
        clear_rows(change, t->width);
        for (j = 0; j < n; j++) {
            double slope = speeds[n - 1] / speeds[j] / total_share;
            if (j != k) slope -= speeds[k] / (speeds[j] - speeds[k]);
            else {
                slope -= 1.0;
                for (i = 0; i < n; i++)
                    if (i != k) slope += speeds[k] / (speeds[i] - speeds[k]);
            }
            add_row(change, shifts[j] + T_RATE * t->width, weights[k] * slope / speeds[j], t->width);
        }
        /* The weights add up to one: only differences of the estimates count. */
        add_row(to + T_TIME * t->width, change, estimate[E_TIME] - last[E_TIME], t->width);
        for (i = 0; i < t->n_x; i++) {
            const long long place = ZL_ESTIMATE_WIDTH + t->n_x + i;
            add_row(to + (T_STATE + i) * t->width, change, estimate[place] - last[place], t->width);
        }
    }
}

static const double *event_row(const Tangent *t, long long event) {
    return t->track->events + event * (ZL_EVENT_WIDTH + 2 * t->n_x);
}

/* The Zeno point of the sequence whose last impact is an event that ends an arc. */
static void limit_shift(const Tangent *t, double *shifts, const double *zeno, long long event,
                        long long arc, double *to) {
    const long long last = t->m.run->pace.n_estimates - 1;
    const double *moves[N_NODES];
    double speeds[N_NODES] = {0.0}, weights[N_NODES], *one = t->slopes;
    long long nodes[N_NODES];
    int n, k;
    if (zeno[3] == 0.0 && zeno[4] > 0.0) {
        /* It was cut by a plastic reset. */
        copy_rows(to, shift_of(t, shifts, arc, 2), (T_STATE + t->n_x) * t->width);
        rested(t, event_row(t, event) + ZL_EVENT_WIDTH + t->n_x, to);
        return;
    }
    n = spread_nodes(&t->m, last, nodes);
    for (k = 0; k < n; k++) speeds[k] = speed_of(&t->m, nodes[n - 1 - k]);
    limit_weights(speeds, n, weights);
    clear_rows(to, (T_STATE + t->n_x) * t->width);
    for (k = 0; k < n; k++) {
        const long long before = last - nodes[n - 1 - k];
        moves[k] = shift_of(t, shifts, arc - before, 2);
        clear_rows(one + T_RATE * t->width, t->width);
        tail(t, event_row(t, event - before) + ZL_EVENT_WIDTH + t->n_x, speeds[k], moves[k], one);
        add_row(to, one, weights[k], (T_STATE + t->n_x) * t->width);
    }
    if (n > 1) reweighted(t, nodes, n, speeds, weights, moves, to);
    rested(t, zeno + ZL_EVENT_WIDTH, to);
}

/* Prepare the perturbations at the start of an arc. */
static void set_out(Tangent *t, long long arc, const double *start) {
    const long long n_x = t->n_x;
    long long k;
    enter_arc(t, arc);
    copy_rows(t->before, start + T_STATE * t->width, n_x * t->width);
    clear_rows(t->before + n_x * t->width, 2 * t->width);
    clear_rows(t->q, (t->n_k + 1) * t->width);
    for (k = 0; k < t->n_k; k++) t->q[k * t->width + n_x + k] = 1.0;
    if (t->mode == ZL_FLIGHT)
        copy_rows(t->q + t->n_k * t->width, start + T_RATE * t->width, t->width);
}

/* Find the next event of a kind at a time; -1 if the next one is another. */
static long long event_at(const Tangent *t, long long event, int kind, double time) {
    if (event >= t->track->n_events) return -1;
    return event_row(t, event)[0] == kind && event_row(t, event)[1] == time ? event : -1;
}

/* Find how the start of a locked arc moves, if it is a Zeno point; 0 if that is not known. */
static int locked_start(const Tangent *t, double *shifts, long long arc, long long *event,
                        long long struck_last, long long arc_last) {
    double *start = shift_of(t, shifts, arc, 0);
    while (*event < t->track->n_events && event_row(t, *event)[0] == ZL_IMPACT) ++*event;
    if (event_at(t, *event, ZL_ZENO, arc_row(t, arc)[1]) < 0) return arc == 0;
    if (t->m.run->pace.n_estimates == 0) return 0;
    limit_shift(t, shifts, event_row(t, *event), struck_last, arc_last, start);
    ++*event;
    t->m.run->pace.n_estimates = 0;
    return 1;
}

long long zl_follow(const zl_problem *problem, const zl_tangent *tangent, zl_run *run,
                    const zl_track *track, int joins, double *shifts) {
    zl_records records;
    Tangent t;
    long long arc, event = 0, struck_last = -1, arc_last = -1, size;
    memset(&records, 0, sizeof records);
    records.estimates = track->estimates;
    t = tangent_of(problem, tangent, run, track, &records);
    size = (T_STATE + t.n_x) * t.width;
    prepare_all(&t);
    run->pace.n_estimates = 0;
    if (joins) {
        joined(&t, arc_row(&t, 0)[1], event_row(&t, 0));
        struck_last = event++;
    }
    for (arc = 0; arc < track->n_arcs; arc++) {
        const double *row = arc_row(&t, arc);
        const int mode = (int)row[0], ending = (int)row[5];
        double *start = shift_of(&t, shifts, arc, 0), *end = shift_of(&t, shifts, arc, 1);
        double *next = shift_of(&t, shifts, arc, 2);
        copy_rows(start, start - size, size);
        while (event < track->n_events && event_row(&t, event)[1] < row[1]) event++;
        if (mode == ZL_LOCKED && !locked_start(&t, shifts, arc, &event, struck_last, arc_last))
            break;
        if (ending == ZL_IMPACT) {
            while (event < track->n_events && event_row(&t, event)[1] < row[2]) event++;
            if (event_at(&t, event, ZL_IMPACT, row[2]) < 0) break;
        }
        copy_rows(end, start, size);
        if (ending != ZL_ZENO) {
            set_out(&t, arc, start);
            (ending == ZL_HORIZON     ? stopped
             : ending == ZL_RELEASE   ? released
             : t.mode == ZL_FLIGHT    ? flown_rescaled
                                      : flown_free)(&t, arc, start, end);
        }
        copy_rows(next, end, size);
        if (ending != ZL_IMPACT) continue;
        struck(&t, event_row(&t, event), end, next);
        joined(&t, row[2], event_row(&t, event));
        struck_last = event++;
        arc_last = arc;
    }
    return arc;
}
