/* A controller as a co-simulation unit of FMI 3.0: each step takes the readings of its begin, sets
   held states if an event has occurred since the last step, and holds the voltages until its end.

       cc -std=c99 -O2 -ffp-contract=off -fPIC -shared fmi3.c -lm -o CONTROLLER.so

   These are the functions that its description offers; `fmi3_refused.c` has all others. */

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include "CONTROLLER.c"

#ifdef _WIN32
#define API __declspec(dllexport)
#elif defined(__GNUC__)
#define API __attribute__((visibility("default")))
#else
#define API
#endif

enum { OK, WARNING, DISCARD, ERROR, FATAL };
enum { INSTANTIATED, INITIALIZATION, STEPS, TERMINATED };
enum { SENSORS = NAME_SENSORS, HELD = NAME_HELD, STOPS = NAME_STOPS, VOLTAGES = NAME_VOLTAGES };

/* Value references: time, sensors, contacts, held states, voltages. */
enum { AT_SENSORS = 1, AT_CONTACTS = AT_SENSORS + SENSORS, AT_HELD = AT_CONTACTS + STOPS };
enum { AT_VOLTAGES = AT_HELD + HELD, N_REFERENCES = AT_VOLTAGES + VOLTAGES };

typedef void (*Log)(void *environment, int status, const char *category, const char *message);

typedef struct {
    int stage, contacts[STOPS + 1];
    double time, stop, sensors[SENSORS + 1], voltages[VOLTAGES + 1];
    NAME_controller controller;
    Log log;
    void *environment;
} Unit;

static int fail(const Unit *unit, const char *text) {
    if (unit->log) unit->log(unit->environment, ERROR, "logStatusError", text);
    return ERROR;
}

API const char *fmi3GetVersion(void);
API void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources,
                                      bool visible, bool logging, bool events, bool early,
                                      const uint32_t intermediate[], size_t n, void *environment,
                                      Log log, void (*update)(void));
API void fmi3FreeInstance(void *instance);
API int fmi3EnterInitializationMode(void *instance, bool has_tolerance, double tolerance,
                                    double start, bool has_stop, double stop);
API int fmi3ExitInitializationMode(void *instance);
API int fmi3EnterStepMode(void *instance);
API int fmi3Terminate(void *instance);
API int fmi3Reset(void *instance);
API int fmi3SetDebugLogging(void *instance, bool on, size_t n, const char *const categories[]);
API int fmi3DoStep(void *instance, double time, double size, bool no_return, bool *event,
                   bool *ends, bool *early, double *reached);
API int fmi3GetFloat64(void *instance, const uint32_t refs[], size_t n, double values[], size_t m);
API int fmi3SetFloat64(void *instance, const uint32_t refs[], size_t n, const double values[],
                       size_t m);
API int fmi3GetBoolean(void *instance, const uint32_t refs[], size_t n, bool values[], size_t m);
API int fmi3SetBoolean(void *instance, const uint32_t refs[], size_t n, const bool values[],
                       size_t m);
API int fmi3GetFMUState(void *instance, void **kept);
API int fmi3SetFMUState(void *instance, void *kept);
API int fmi3FreeFMUState(void *instance, void **kept);

const char *fmi3GetVersion(void) { return "3.0"; }

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

void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources,
                                  bool visible, bool logging, bool events, bool early,
                                  const uint32_t intermediate[], size_t n, void *environment,
                                  Log log, void (*update)(void)) {
    Unit *unit;
    (void)name, (void)resources, (void)visible, (void)logging, (void)early;
    (void)intermediate, (void)update;
    if (!token || strcmp(token, INSTANTIATION_TOKEN) != 0 || events || n > 0) {
        if (log) log(environment, ERROR, "logStatusError", "The unit does not fit its description");
        return 0;
    }
    unit = calloc(1, sizeof *unit);
    if (!unit) return 0;
    unit->log = log;
    unit->environment = environment;
    set_up(unit);
    return unit;
}

void fmi3FreeInstance(void *instance) { free(instance); }

int fmi3EnterInitializationMode(void *instance, bool has_tolerance, double tolerance, double start,
                                bool has_stop, double stop) {
    Unit *unit = instance;
    (void)has_tolerance, (void)tolerance;
    if (unit->stage != INSTANTIATED) return fail(unit, "The unit is initialized already");
    if (has_stop && !(stop > start)) return fail(unit, "The stop time must be after the start");
    unit->time = start;
    if (has_stop) unit->stop = stop;
    unit->stage = INITIALIZATION;
    return OK;
}

int fmi3ExitInitializationMode(void *instance) {
    Unit *unit = instance;
    double x[STATES];
    if (unit->stage != INITIALIZATION) return fail(unit, "The unit is not initialized");
    joined(&unit->controller, unit->sensors, x);
    voltage(x, unit->voltages);
    unit->stage = STEPS;
    return OK;
}

int fmi3EnterStepMode(void *instance) {
    Unit *unit = instance;
    return unit->stage == STEPS ? OK : fail(unit, "The unit takes no steps yet");
}

int fmi3Terminate(void *instance) {
    Unit *unit = instance;
    unit->stage = TERMINATED;
    return OK;
}

int fmi3Reset(void *instance) {
    set_up(instance);
    return OK;
}

int fmi3SetDebugLogging(void *instance, bool on, size_t n, const char *const categories[]) {
    (void)instance, (void)on, (void)n, (void)categories;
    return OK;
}

int fmi3DoStep(void *instance, double time, double size, bool no_return, bool *event, bool *ends,
               bool *early, double *reached) {
    Unit *unit = instance;
    const double end = time + size;
    (void)no_return;
    *event = *ends = *early = false;
    *reached = unit->time;
    if (unit->stage != STEPS) return fail(unit, "The unit takes no steps now");
    if (!(size >= 0.0) || !(fabs(time - unit->time) <= 1e-9 * (1.0 + fabs(time))))
        return fail(unit, "A step must start where the last one ended");
    /* Sums of step sizes pass the stop time by rounding. */
    if (end > unit->stop + 1e-9 * (1.0 + fabs(end)))
        return fail(unit, "The step ends after the stop time");
    NAME_step(&unit->controller, time, unit->sensors, unit->contacts, unit->voltages);
    *reached = unit->time = end;
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
    if (!*kept) *kept = calloc(1, sizeof *unit);
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
