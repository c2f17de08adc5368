/* A leg by itself: a flow from a state until its guard falls, with no event after it. */

/* Prepare a leg of the mode off the stop over the time of the settings. After a start on the guard
   itself, `on_guard`, the root there is no fall. Nor is one that is `late`: so near the end. */
int zl_begin_leg(const zl_problem *problem, zl_run *run, const zl_settings *settings,
                 const double *p, const double *y, int on_guard, double rounding, double late) {
    const int status = zl_begin(problem, run, settings, p, y);
    const Machine m = machine_of(problem, run, 0);
    if (status != ZL_DONE) return status;
    run->pace.next_look = INT64_MAX;
    run->leg.on_guard = on_guard;
    run->leg.rounding = rounding;
    if (!begin_leg(&m, ZL_FREE, 1.0, y, settings->until, settings->relative, settings->absolute)) {
        run->leg.time = 0.0;
        return step_failed(run, ZL_NOT_FINITE);
    }
    run->leg.late = late;
    run->stage = IN_LEG;
    return ZL_DONE;
}

/* Go on with it until it ends, as the one arc of the records, or a record is full. */
int zl_resume_leg(const zl_problem *problem, zl_run *run, zl_records *records) {
    const Machine m = machine_of(problem, run, records);
    int outcome = LEG_GOES_ON;
    records->n_steps = records->n_polynomials = records->n_arcs = records->n_events = 0;
    while (outcome == LEG_GOES_ON) {
        if (!has_room(&m)) return ZL_FULL;
        outcome = step_leg(&m);
    }
    if (outcome != LEG_FELL && outcome != LEG_AT_HORIZON) return outcome;
    write_leg(&m, outcome == LEG_FELL ? ZL_IMPACT : ZL_HORIZON, run->leg.duration);
    run->stage = OVER;
    return ZL_DONE;
}
