/* What every unit of FMI 3.0 does alike: its stages, and steps in order. The file that includes this
   one has the structure `Unit`, whose stage, time and stop time are in `AT(unit)`, and the functions
   `new_unit`, `set_up`, `take_tolerance` and `step_to`. */

static int fail(const Unit *unit, const char *text) {
    if (unit->log) unit->log(unit->environment, ERROR, "logStatusError", text);
    return ERROR;
}

const char *fmi3GetVersion(void) { return "3.0"; }

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
    unit = new_unit();
    if (!unit) return 0;
    unit->log = log;
    unit->environment = environment;
    set_up(unit);
    return unit;
}

int fmi3EnterInitializationMode(void *instance, bool has_tolerance, double tolerance, double start,
                                bool has_stop, double stop) {
    Unit *unit = instance;
    if (AT(unit).stage != INSTANTIATED) return fail(unit, "The unit is initialized already");
    if (has_tolerance && tolerance > 0.0) take_tolerance(unit, tolerance);
    if (has_stop && !(stop > start)) return fail(unit, "The stop time must be after the start");
    AT(unit).time = start;
    if (has_stop) AT(unit).stop = stop;
    AT(unit).stage = INITIALIZATION;
    return OK;
}

int fmi3EnterStepMode(void *instance) {
    Unit *unit = instance;
    return AT(unit).stage == STEPS ? OK : fail(unit, "The unit takes no steps yet");
}

int fmi3Terminate(void *instance) {
    Unit *unit = instance;
    AT(unit).stage = TERMINATED;
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
    int status;
    (void)no_return;
    *event = *ends = *early = false;
    *reached = AT(unit).time;
    if (AT(unit).stage != STEPS) return fail(unit, "The unit takes no steps now");
    if (!(size >= 0.0) || !(fabs(time - AT(unit).time) <= 1e-9 * (1.0 + fabs(time))))
        return fail(unit, "A step must start where the last one ended");
    /* Sums of step sizes pass the stop time by rounding. */
    if (end > AT(unit).stop + 1e-9 * (1.0 + fabs(end)))
        return fail(unit, "The step ends after the stop time");
    status = step_to(unit, time, end);
    *reached = AT(unit).time;
    return status;
}
