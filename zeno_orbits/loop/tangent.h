/* Derivatives of a recorded execution by its start and by chosen parameters: types and functions.

   All derivatives have one column for every state of the start and every chosen parameter. A row of
   them is `width` numbers, columns and then zeros, a multiple of ZL_LANES. */

enum {
    ZL_LINEAR = 0,         /* of a mode: the entries of its variational equation */
    ZL_CONTACT_SLOPES = 3, /* of gap, its rate and acceleration, multiplier and its rate */
    ZL_RESET_SLOPES,       /* of the state after an impact, by state, approach rate, parameters */
    ZL_REBOUND_SLOPES,     /* of the gap rate after an impact, by that before it, and parameters */
    ZL_RESTING_SLOPES,     /* of the state on the stop, its gap acceleration, its locked flow */
    ZL_SLOPES
};

typedef struct {
    long long n_chosen; /* parameters */
    zl_tape tapes[ZL_SLOPES];
    const int *rows[ZL_MODES], *columns[ZL_MODES]; /* places of the entries of ZL_LINEAR */
    /* States that depend on each other in a circle: all states in order, and where blocks end. */
    const int *states[ZL_MODES], *ends[ZL_MODES];
    long long n_blocks[ZL_MODES];
    double matrix[ZL_STAGES * ZL_STAGES]; /* of Radau IIA, by rows */
} zl_tangent;

/* What is followed, and memory. */
typedef struct {
    const double *steps, *polynomials, *arcs, *events;
    long long n_arcs, n_events;
    double trusted;              /* error of an explicit step up to which it serves */
    const double *restitution;   /* its derivatives by the chosen parameters */
    double *estimates, *work;    /* rows of ZL_ESTIMATE_WIDTH + 2 n_x, one more than arcs; zl_tangent_work */
} zl_track;

ZL_EXPORT long long zl_tangent_work(const zl_problem *problem, const zl_tangent *tangent);

/* Follow the arcs. A shift is rows: of time, of gap rate, of every state. `shifts` has three an arc:
   of its start, of its end before an impact, of what follows the event at its end. Those of the
   first arc come after three of an arc before it, of which the last is given. If `joins`, the first
   event is the impact before the first arc, with which a sequence of impacts begins. Returns the
   number of arcs that have derivatives. */
ZL_EXPORT long long zl_follow(const zl_problem *problem, const zl_tangent *tangent, zl_run *run,
                              const zl_track *track, int joins, double *shifts);

/* Carry derivatives `v` along the first arc, of parameters that move as `q`. After every part of
   every step: its time in the flow's own time, then the derivatives; `rows` has room for all. */
ZL_EXPORT void zl_course(const zl_problem *problem, const zl_tangent *tangent, zl_run *run,
                         const zl_track *track, int parts, const double *v, const double *q,
                         double *times, double *rows);
