/* A controller as a co-simulation unit of FMI 3.0: each step takes the readings of its begin, sets
   held states if an event has occurred since the last step, and holds the voltages until its end.

       cc -std=c99 -O2 -ffp-contract=off -fPIC -shared fmi3.c -lm -o CONTROLLER.so

   These functions and those of `fmi3_calls.c` are what its description offers; `fmi3_refused.c` has all
   others. */

#include "CONTROLLER.c"
#include "fmi3_head.c"

enum { SENSORS = NAME_SENSORS, HELD = NAME_HELD, STOPS = NAME_STOPS, VOLTAGES = NAME_VOLTAGES };

/* Value references: time, sensors, contacts, held states, voltages. */
enum { AT_SENSORS = 1, AT_CONTACTS = AT_SENSORS + SENSORS, AT_HELD = AT_CONTACTS + STOPS };
enum { AT_VOLTAGES = AT_HELD + HELD, N_REFERENCES = AT_VOLTAGES + VOLTAGES };

typedef struct {
    int stage, contacts[STOPS + 1];
    double time, stop, sensors[SENSORS + 1], voltages[VOLTAGES + 1];
    NAME_controller controller;
    Log log;
    void *environment;
} Unit;

API int fmi3GetBoolean(void *instance, const uint32_t refs[], size_t n, bool values[], size_t m);
API int fmi3SetBoolean(void *instance, const uint32_t refs[], size_t n, const bool values[],
                       size_t m);

/* Everything as it is after instantiation. */
static void set_up(Unit *unit) {
    memset(unit->contacts, 0, sizeof unit->contacts);
    memset(unit->voltages, 0, sizeof unit->voltages);
    memcpy(unit->sensors, FIRST_SENSORS, SENSORS * sizeof(double));
    unit->stage = INSTANTIATED;
    unit->time = 0.0;
    unit->stop = 1e300;
    NAME_begin(&unit->controller);
}

static Unit *new_unit(void) { return calloc(1, sizeof(Unit)); }

static void take_tolerance(Unit *unit, double relative) { (void)unit, (void)relative; }

static int step_to(Unit *unit, double begin, double end) {
    NAME_step(&unit->controller, begin, unit->sensors, unit->contacts, unit->voltages);
    unit->time = end;
    return OK;
}

#define AT(unit) (*(unit))
#include "fmi3_calls.c"

void fmi3FreeInstance(void *instance) { free(instance); }

int fmi3ExitInitializationMode(void *instance) {
    Unit *unit = instance;
    double x[STATES];
    if (unit->stage != INITIALIZATION) return fail(unit, "The unit is not initialized");
    joined(&unit->controller, unit->sensors, x);
    voltage(x, unit->voltages);
    unit->stage = STEPS;
    return OK;
}

int fmi3GetFloat64(void *instance, const uint32_t refs[], size_t n, double values[], size_t m) {
    const Unit *unit = instance;
    size_t k;
    if (n != m) return fail(unit, "Every variable has one value");
    for (k = 0; k < n; k++) {
        const long long ref = refs[k];
        if (ref == 0)
            values[k] = unit->time;
        else if (ref < AT_CONTACTS)
            values[k] = unit->sensors[ref - AT_SENSORS];
        else if (ref >= AT_HELD && ref < AT_VOLTAGES)
            values[k] = unit->controller.held[ref - AT_HELD];
        else if (ref >= AT_VOLTAGES && ref < N_REFERENCES)
            values[k] = unit->voltages[ref - AT_VOLTAGES];
        else
            return fail(unit, "There is no such variable of type Float64");
    }
    return OK;
}

int fmi3SetFloat64(void *instance, const uint32_t refs[], size_t n, const double values[],
                   size_t m) {
    Unit *unit = instance;
    size_t k;
    if (n != m) return fail(unit, "Every variable has one value");
    /* A call that is refused changes nothing. */
    for (k = 0; k < n; k++) {
        const long long ref = refs[k];
        if (ref < AT_SENSORS || ref >= AT_CONTACTS) return fail(unit, "The variable cannot be set");
        if (!isfinite(values[k])) return fail(unit, "A value must be finite");
    }
    for (k = 0; k < n; k++) unit->sensors[refs[k] - AT_SENSORS] = values[k];
    return OK;
}

static int all_contacts(const Unit *unit, const uint32_t refs[], size_t n, size_t m) {
    size_t k;
    if (n != m) return fail(unit, "Every variable has one value");
    for (k = 0; k < n; k++) {
        const long long ref = refs[k];
        if (ref < AT_CONTACTS || ref >= AT_HELD)
            return fail(unit, "There is no such variable of type Boolean");
    }
    return OK;
}

int fmi3GetBoolean(void *instance, const uint32_t refs[], size_t n, bool values[], size_t m) {
    const Unit *unit = instance;
    size_t k;
    if (all_contacts(unit, refs, n, m) != OK) return ERROR;
    for (k = 0; k < n; k++) values[k] = unit->contacts[refs[k] - AT_CONTACTS] != 0;
    return OK;
}

int fmi3SetBoolean(void *instance, const uint32_t refs[], size_t n, const bool values[], size_t m) {
    Unit *unit = instance;
    size_t k;
    if (all_contacts(unit, refs, n, m) != OK) return ERROR;
    for (k = 0; k < n; k++) unit->contacts[refs[k] - AT_CONTACTS] = values[k];
    return OK;
}

int fmi3GetFMUState(void *instance, void **kept) {
    const Unit *unit = instance;
    if (!*kept) *kept = new_unit();
    if (!*kept) return fail(unit, "There is no memory");
    memcpy(*kept, unit, sizeof *unit);
    return OK;
}

int fmi3SetFMUState(void *instance, void *kept) {
    memcpy(instance, kept, sizeof(Unit));
    return OK;
}

int fmi3FreeFMUState(void *instance, void **kept) {
    (void)instance;
    free(*kept);
    *kept = 0;
    return OK;
}

#define HAS_BOOLEAN
#include "fmi3_refused.c"
