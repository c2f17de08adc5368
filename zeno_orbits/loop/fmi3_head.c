/* What comes first in every unit of FMI 3.0: names of its stages, and the functions that all offer. */

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#define API __declspec(dllexport)
#elif defined(__GNUC__)
#define API __attribute__((visibility("default")))
#else
#define API
#endif

enum { OK, WARNING, DISCARD, ERROR, FATAL };
enum { INSTANTIATED, INITIALIZATION, STEPS, TERMINATED };

typedef void (*Log)(void *environment, int status, const char *category, const char *message);

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
API int fmi3GetFMUState(void *instance, void **kept);
API int fmi3SetFMUState(void *instance, void *kept);
API int fmi3FreeFMUState(void *instance, void **kept);
