/* Functions of FMI 3.0 that the unit does not offer: its description excludes them. */

typedef void *I;
typedef const uint32_t *Refs;

/* Getter and setter of a type that no variable has. */
#define NO_VALUES(NAME, TYPE)                                                                      \
    API int fmi3Get##NAME(I unit, Refs refs, size_t n, TYPE values[], size_t m);                   \
    API int fmi3Set##NAME(I unit, Refs refs, size_t n, TYPE const values[], size_t m);             \
    int fmi3Get##NAME(I unit, Refs refs, size_t n, TYPE values[], size_t m) {                      \
        (void)refs, (void)values, (void)m;                                                         \
        return n ? fail(unit, "There is no variable of type " #NAME) : OK;                         \
    }                                                                                              \
    int fmi3Set##NAME(I unit, Refs refs, size_t n, TYPE const values[], size_t m) {                \
        (void)refs, (void)values, (void)m;                                                         \
        return n ? fail(unit, "There is no variable of type " #NAME " to set") : OK;               \
    }

NO_VALUES(Float32, float)
NO_VALUES(Int8, int8_t)
NO_VALUES(UInt8, uint8_t)
NO_VALUES(Int16, int16_t)
NO_VALUES(UInt16, uint16_t)
NO_VALUES(UInt32, uint32_t)
NO_VALUES(Int64, int64_t)
NO_VALUES(UInt64, uint64_t)
NO_VALUES(String, const char *)
#ifdef HAS_BOOLEAN
NO_VALUES(Int32, int32_t)
#else
NO_VALUES(Boolean, bool)
#endif

/* A function with given parameters and their names. */
#define REFUSED(NAME, PARAMETERS, NAMES)                                                           \
    API int fmi3##NAME PARAMETERS;                                                                 \
    int fmi3##NAME PARAMETERS {                                                                    \
        NAMES;                                                                                     \
        return fail(unit, "The unit does not offer fmi3" #NAME);                                   \
    }

#ifndef HAS_BOOLEAN
REFUSED(SetInt32, (I unit, Refs a, size_t b, const int32_t c[], size_t d),
        ((void)a, (void)b, (void)c, (void)d))
#endif
REFUSED(GetBinary, (I unit, Refs a, size_t b, size_t c[], const uint8_t *d[], size_t e),
        ((void)a, (void)b, (void)c, (void)d, (void)e))
REFUSED(SetBinary, (I unit, Refs a, size_t b, const size_t c[], const uint8_t *const d[], size_t e),
        ((void)a, (void)b, (void)c, (void)d, (void)e))
REFUSED(GetClock, (I unit, Refs a, size_t b, bool c[]), ((void)a, (void)b, (void)c))
REFUSED(SetClock, (I unit, Refs a, size_t b, const bool c[]), ((void)a, (void)b, (void)c))
REFUSED(EnterEventMode, (I unit), ((void)0))
REFUSED(GetNumberOfVariableDependencies, (I unit, uint32_t a, size_t *b), ((void)a, (void)b))
REFUSED(GetVariableDependencies, (I unit, uint32_t a, size_t b[], uint32_t c[], size_t d[],
        int e[], size_t f),
        ((void)a, (void)b, (void)c, (void)d, (void)e, (void)f))
REFUSED(SerializedFMUStateSize, (I unit, void *a, size_t *b), ((void)a, (void)b))
REFUSED(SerializeFMUState, (I unit, void *a, uint8_t b[], size_t c), ((void)a, (void)b, (void)c))
REFUSED(DeserializeFMUState, (I unit, const uint8_t a[], size_t b, void **c),
        ((void)a, (void)b, (void)c))
REFUSED(GetDirectionalDerivative, (I unit, Refs a, size_t b, Refs c, size_t d, const double e[],
        size_t f, double g[], size_t h),
        ((void)a, (void)b, (void)c, (void)d, (void)e, (void)f, (void)g, (void)h))
REFUSED(GetAdjointDerivative, (I unit, Refs a, size_t b, Refs c, size_t d, const double e[],
        size_t f, double g[], size_t h),
        ((void)a, (void)b, (void)c, (void)d, (void)e, (void)f, (void)g, (void)h))
REFUSED(EnterConfigurationMode, (I unit), ((void)0))
REFUSED(ExitConfigurationMode, (I unit), ((void)0))
REFUSED(GetIntervalDecimal, (I unit, Refs a, size_t b, double c[], int d[]),
        ((void)a, (void)b, (void)c, (void)d))
REFUSED(GetIntervalFraction, (I unit, Refs a, size_t b, uint64_t c[], uint64_t d[], int e[]),
        ((void)a, (void)b, (void)c, (void)d, (void)e))
REFUSED(GetShiftDecimal, (I unit, Refs a, size_t b, double c[]), ((void)a, (void)b, (void)c))
REFUSED(GetShiftFraction, (I unit, Refs a, size_t b, uint64_t c[], uint64_t d[]),
        ((void)a, (void)b, (void)c, (void)d))
REFUSED(SetIntervalDecimal, (I unit, Refs a, size_t b, const double c[]),
        ((void)a, (void)b, (void)c))
REFUSED(SetIntervalFraction, (I unit, Refs a, size_t b, const uint64_t c[], const uint64_t d[]),
        ((void)a, (void)b, (void)c, (void)d))
REFUSED(SetShiftDecimal, (I unit, Refs a, size_t b, const double c[]), ((void)a, (void)b, (void)c))
REFUSED(SetShiftFraction, (I unit, Refs a, size_t b, const uint64_t c[], const uint64_t d[]),
        ((void)a, (void)b, (void)c, (void)d))
REFUSED(EvaluateDiscreteStates, (I unit), ((void)0))
REFUSED(UpdateDiscreteStates, (I unit, bool *a, bool *b, bool *c, bool *d, bool *e, double *f),
        ((void)a, (void)b, (void)c, (void)d, (void)e, (void)f))
REFUSED(EnterContinuousTimeMode, (I unit), ((void)0))
REFUSED(CompletedIntegratorStep, (I unit, bool a, bool *b, bool *c), ((void)a, (void)b, (void)c))
REFUSED(SetTime, (I unit, double a), ((void)a))
REFUSED(SetContinuousStates, (I unit, const double a[], size_t b), ((void)a, (void)b))
REFUSED(GetContinuousStateDerivatives, (I unit, double a[], size_t b), ((void)a, (void)b))
REFUSED(GetEventIndicators, (I unit, double a[], size_t b), ((void)a, (void)b))
REFUSED(GetContinuousStates, (I unit, double a[], size_t b), ((void)a, (void)b))
REFUSED(GetNominalsOfContinuousStates, (I unit, double a[], size_t b), ((void)a, (void)b))
REFUSED(GetNumberOfEventIndicators, (I unit, size_t *a), ((void)a))
REFUSED(GetNumberOfContinuousStates, (I unit, size_t *a), ((void)a))
REFUSED(GetOutputDerivatives, (I unit, Refs a, size_t b, const int32_t c[], double d[], size_t e),
        ((void)a, (void)b, (void)c, (void)d, (void)e))
REFUSED(ActivateModelPartition, (I unit, uint32_t a, double b), ((void)a, (void)b))

API void *fmi3InstantiateModelExchange(const char *name, const char *token, const char *resources,
                                       bool visible, bool logging, void *environment, Log log);
API void *fmi3InstantiateScheduledExecution(const char *name, const char *token,
                                            const char *resources, bool visible, bool logging,
                                            void *environment, Log log, void (*update)(void),
                                            void (*lock)(void), void (*unlock)(void));

void *fmi3InstantiateModelExchange(const char *name, const char *token, const char *resources,
                                   bool visible, bool logging, void *environment, Log log) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging;
    if (log) log(environment, ERROR, "logStatusError", "The unit is for co-simulation");
    return 0;
}

void *fmi3InstantiateScheduledExecution(const char *name, const char *token, const char *resources,
                                        bool visible, bool logging, void *environment, Log log,
                                        void (*update)(void), void (*lock)(void),
                                        void (*unlock)(void)) {
    (void)update, (void)lock, (void)unlock;
    return fmi3InstantiateModelExchange(name, token, resources, visible, logging, environment, log);
}
