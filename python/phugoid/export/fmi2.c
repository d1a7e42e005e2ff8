/*
 * FMI 2.0 for a model exported by phugoid: model exchange and co-simulation (FMI 2.0.3, https://fmi-standard.org).
 *
 * Value references: states, their derivatives, inputs, parameters, outputs, one after the other. Co-simulation takes
 * Runge-Kutta steps of order 4, none longer than MODEL_STEP, over which inputs run on with the derivatives that were set.
 */
#include "fmi2Functions.h"
#include "fmi2_model.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define AT_LEAST_1(n) ((n) > 0 ? (n) : 1)
#define FIRST_DX N_X
#define FIRST_U (2 * N_X)
#define FIRST_P (FIRST_U + N_U)
#define FIRST_Y (FIRST_P + N_P)
#define ALL (FIRST_Y + N_Y)

typedef struct {
    double t;
    double x[AT_LEAST_1(N_X)];
    double u[AT_LEAST_1(N_U)];
    double u_slope[AT_LEAST_1(N_U)];
    double p[AT_LEAST_1(N_P)];
} Values;

typedef struct {
    Values now;
    double start; /* time at which the experiment begins */
    char *name;
    fmi2CallbackFunctions callbacks;
} Instance;

static fmi2Status refused(const Instance *m, const char *message) {
    if (m != NULL && m->callbacks.logger != NULL) {
        m->callbacks.logger(m->callbacks.componentEnvironment, m->name, fmi2Error, "error", "%s", message);
    }
    return fmi2Error;
}

static void begin(Values *v, double t) {
    int i;
    memset(v, 0, sizeof *v);
    v->t = t;
    for (i = 0; i < N_X; ++i) v->x[i] = model_x0[i];
    for (i = 0; i < N_U; ++i) v->u[i] = model_u0[i];
    for (i = 0; i < N_P; ++i) v->p[i] = model_p[i];
}

static int finite(const double *values, int n) {
    int i;
    for (i = 0; i < n; ++i) {
        if (!isfinite(values[i])) return 0;
    }
    return 1;
}

/* Common */

FMI2_Export const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

FMI2_Export const char *fmi2GetVersion(void) { return fmi2Version; }

FMI2_Export fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    (void)c; (void)on; (void)n; (void)categories;
    return fmi2OK;
}

FMI2_Export fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                          const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                                          fmi2Boolean logging) {
    Instance *m;
    (void)type; (void)resources; (void)visible; (void)logging;
    if (guid == NULL || strcmp(guid, MODEL_GUID) != 0) {
        if (functions != NULL && functions->logger != NULL) {
            functions->logger(functions->componentEnvironment, name, fmi2Error, "error", "%s",
                              "the GUID is not that of this model");
        }
        return NULL;
    }
    m = (Instance *)calloc(1, sizeof *m);
    if (m == NULL) return NULL;
    m->name = (char *)calloc(name == NULL ? 1 : strlen(name) + 1, 1);
    if (m->name == NULL) {
        free(m);
        return NULL;
    }
    if (name != NULL) strcpy(m->name, name);
    if (functions != NULL) m->callbacks = *functions;
    begin(&m->now, 0.0);
    return m;
}

FMI2_Export void fmi2FreeInstance(fmi2Component c) {
    Instance *m = (Instance *)c;
    if (m == NULL) return;
    free(m->name);
    free(m);
}

FMI2_Export fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance,
                                           fmi2Real start, fmi2Boolean stop_defined, fmi2Real stop) {
    Instance *m = (Instance *)c;
    (void)tolerance_defined; (void)tolerance; (void)stop_defined; (void)stop;
    m->start = m->now.t = start;
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2EnterInitializationMode(fmi2Component c) { (void)c; return fmi2OK; }

FMI2_Export fmi2Status fmi2ExitInitializationMode(fmi2Component c) { (void)c; return fmi2OK; }

FMI2_Export fmi2Status fmi2Terminate(fmi2Component c) { (void)c; return fmi2OK; }

FMI2_Export fmi2Status fmi2Reset(fmi2Component c) {
    Instance *m = (Instance *)c;
    begin(&m->now, m->start);
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    Instance *m = (Instance *)c;
    Values *v = &m->now;
    double dx[AT_LEAST_1(N_X)], y[AT_LEAST_1(N_Y)];
    int have_dx = 0, have_y = 0;
    size_t k;
    for (k = 0; k < n; ++k) {
        const unsigned int i = vr[k];
        if (i < FIRST_DX) {
            value[k] = v->x[i];
        } else if (i < FIRST_U) {
            if (!have_dx) model_dynamics(v->t, v->x, v->u, v->p, dx);
            have_dx = 1;
            value[k] = dx[i - FIRST_DX];
        } else if (i < FIRST_P) {
            value[k] = v->u[i - FIRST_U];
        } else if (i < FIRST_Y) {
            value[k] = v->p[i - FIRST_P];
        } else if (i < ALL) {
            if (!have_y) model_outputs(v->t, v->x, v->u, v->p, y);
            have_y = 1;
            value[k] = y[i - FIRST_Y];
        } else {
            return refused(m, "fmi2GetReal: there is no such value reference");
        }
    }
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    Instance *m = (Instance *)c;
    size_t k;
    for (k = 0; k < n; ++k) {
        const unsigned int i = vr[k];
        if (i < FIRST_DX) {
            m->now.x[i] = value[k];
        } else if (i >= FIRST_U && i < FIRST_P) {
            m->now.u[i - FIRST_U] = value[k];
        } else if (i >= FIRST_P && i < FIRST_Y) {
            m->now.p[i - FIRST_P] = value[k];
        } else {
            return refused(m, "fmi2SetReal: this variable is no state, input or parameter");
        }
    }
    return fmi2OK;
}

/* There are real variables only. */
#define NONE(what, type)                                                                                       \
    FMI2_Export fmi2Status what(fmi2Component c, const fmi2ValueReference vr[], size_t n, type value[]) {      \
        (void)vr; (void)value;                                                                                 \
        return n == 0 ? fmi2OK : refused((Instance *)c, #what ": there are real variables only");             \
    }
NONE(fmi2GetInteger, fmi2Integer)
NONE(fmi2GetBoolean, fmi2Boolean)
NONE(fmi2GetString, fmi2String)
NONE(fmi2SetInteger, const fmi2Integer)
NONE(fmi2SetBoolean, const fmi2Boolean)
NONE(fmi2SetString, const fmi2String)

/* What moves; also as bytes */

FMI2_Export fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
    if (*state == NULL) *state = malloc(sizeof(Values));
    if (*state == NULL) return refused((Instance *)c, "fmi2GetFMUstate: there is no memory left");
    memcpy(*state, &((Instance *)c)->now, sizeof(Values));
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
    if (state == NULL) return refused((Instance *)c, "fmi2SetFMUstate: there is no state");
    memcpy(&((Instance *)c)->now, state, sizeof(Values));
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    (void)c;
    free(*state);
    *state = NULL;
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
    (void)c; (void)state;
    *size = sizeof(Values);
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    if (state == NULL || size < sizeof(Values)) return refused((Instance *)c, "fmi2SerializeFMUstate: no room");
    memcpy(bytes, state, sizeof(Values));
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size,
                                               fmi2FMUstate *state) {
    if (size != sizeof(Values)) return refused((Instance *)c, "fmi2DeSerializeFMUstate: these are other bytes");
    if (*state == NULL) *state = malloc(sizeof(Values));
    if (*state == NULL) return refused((Instance *)c, "fmi2DeSerializeFMUstate: there is no memory left");
    memcpy(*state, bytes, size);
    return fmi2OK;
}

/* Derivatives of state derivatives and outputs by states and inputs, exact */

FMI2_Export fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[],
                                                    size_t n_unknown, const fmi2ValueReference known[],
                                                    size_t n_known, const fmi2Real d_known[], fmi2Real d_unknown[]) {
    Instance *m = (Instance *)c;
    const Values *v = &m->now;
    double a[AT_LEAST_1(N_X * N_X)], b[AT_LEAST_1(N_X * N_U)], of_x[AT_LEAST_1(N_Y * N_X)], of_u[AT_LEAST_1(N_Y * N_U)];
    size_t k, l;
    model_jacobians(v->t, v->x, v->u, v->p, a, b, of_x, of_u);
    for (k = 0; k < n_unknown; ++k) {
        const unsigned int i = unknown[k];
        const int rate = i >= FIRST_DX && i < FIRST_U;
        if (!rate && !(i >= FIRST_Y && i < ALL)) {
            return refused(m, "fmi2GetDirectionalDerivative: unknowns are derivatives of states and outputs");
        }
        d_unknown[k] = 0.0;
        for (l = 0; l < n_known; ++l) {
            const unsigned int j = known[l];
            if (j < FIRST_DX) {
                d_unknown[k] += d_known[l] * (rate ? a[(i - FIRST_DX) * N_X + j] : of_x[(i - FIRST_Y) * N_X + j]);
            } else if (j >= FIRST_U && j < FIRST_P) {
                d_unknown[k] += d_known[l]
                    * (rate ? b[(i - FIRST_DX) * N_U + j - FIRST_U] : of_u[(i - FIRST_Y) * N_U + j - FIRST_U]);
            } else {
                return refused(m, "fmi2GetDirectionalDerivative: knowns are states and inputs");
            }
        }
    }
    return fmi2OK;
}

/* Model exchange */

FMI2_Export fmi2Status fmi2EnterEventMode(fmi2Component c) { (void)c; return fmi2OK; }

FMI2_Export fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    (void)c;
    memset(info, 0, sizeof *info);
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { (void)c; return fmi2OK; }

FMI2_Export fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_set, fmi2Boolean *enter_event_mode,
                                                   fmi2Boolean *terminate) {
    (void)c; (void)no_set;
    *enter_event_mode = *terminate = fmi2False;
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
    ((Instance *)c)->now.t = time;
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
    if (n != N_X) return refused((Instance *)c, "fmi2SetContinuousStates: the number of states is another");
    memcpy(((Instance *)c)->now.x, x, n * sizeof *x);
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    if (n != N_X) return refused((Instance *)c, "fmi2GetContinuousStates: the number of states is another");
    memcpy(x, ((Instance *)c)->now.x, n * sizeof *x);
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n) {
    Instance *m = (Instance *)c;
    if (n != N_X) return refused(m, "fmi2GetDerivatives: the number of states is another");
    model_dynamics(m->now.t, m->now.x, m->now.u, m->now.p, dx);
    /* An integrator may try a shorter step. */
    return finite(dx, N_X) ? fmi2OK : fmi2Discard;
}

FMI2_Export fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real indicators[], size_t n) {
    (void)indicators;
    return n == 0 ? fmi2OK : refused((Instance *)c, "fmi2GetEventIndicators: there are none");
}

FMI2_Export fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real nominal[], size_t n) {
    size_t k;
    if (n != N_X) return refused((Instance *)c, "fmi2GetNominalsOfContinuousStates: the number of states is another");
    for (k = 0; k < n; ++k) nominal[k] = model_nominal[k];
    return fmi2OK;
}

/* Co-simulation */

FMI2_Export fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                                   const fmi2Integer order[], const fmi2Real value[]) {
    Instance *m = (Instance *)c;
    size_t k;
    for (k = 0; k < n; ++k) {
        if (vr[k] < FIRST_U || vr[k] >= FIRST_P) return refused(m, "fmi2SetRealInputDerivatives: this is no input");
        if (order[k] != 1) return refused(m, "fmi2SetRealInputDerivatives: first derivatives only");
        m->now.u_slope[vr[k] - FIRST_U] = value[k];
    }
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                                    const fmi2Integer order[], fmi2Real value[]) {
    (void)vr; (void)order; (void)value;
    return n == 0 ? fmi2OK : refused((Instance *)c, "fmi2GetRealOutputDerivatives: there are none");
}

FMI2_Export fmi2Status fmi2DoStep(fmi2Component c, fmi2Real at, fmi2Real size, fmi2Boolean no_set) {
    Instance *m = (Instance *)c;
    Values next = m->now;
    double u0[AT_LEAST_1(N_U)], u1[AT_LEAST_1(N_U)];
    /* A step that is longer by rounding only is not two. */
    const double steps = ceil(size / MODEL_STEP - 1e-9);
    const long n = steps > 1.0 ? (long)steps : 1;
    const double h = size / (double)n;
    long s;
    int i;
    (void)no_set;
    if (!(size >= 0.0) || steps > 1e9) return refused(m, "fmi2DoStep: the step is negative, or too long");
    for (i = 0; i < N_U; ++i) u1[i] = next.u[i];
    for (s = 0; s < n; ++s) {
        for (i = 0; i < N_U; ++i) {
            u0[i] = u1[i];
            u1[i] = next.u[i] + (double)(s + 1) * h * next.u_slope[i];
        }
        model_step(at + (double)s * h, h, u0, u1, next.p, next.x);
    }
    if (!finite(next.x, N_X)) return refused(m, "fmi2DoStep: the solution ceases to exist");
    for (i = 0; i < N_U; ++i) {
        next.u[i] = u1[i];
        next.u_slope[i] = 0.0; /* said anew for each step */
    }
    next.t = at + size;
    m->now = next;
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2CancelStep(fmi2Component c) {
    return refused((Instance *)c, "fmi2CancelStep: steps end at once");
}

#define NO_STATUS(what, type)                                                          \
    FMI2_Export fmi2Status what(fmi2Component c, const fmi2StatusKind kind, type *value) { \
        (void)kind; (void)value;                                                       \
        return refused((Instance *)c, #what ": steps end at once");                    \
    }
NO_STATUS(fmi2GetStatus, fmi2Status)
NO_STATUS(fmi2GetIntegerStatus, fmi2Integer)
NO_STATUS(fmi2GetBooleanStatus, fmi2Boolean)
NO_STATUS(fmi2GetStringStatus, fmi2String)

FMI2_Export fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    if (kind != fmi2LastSuccessfulTime) return refused((Instance *)c, "fmi2GetRealStatus: steps end at once");
    *value = ((Instance *)c)->now.t;
    return fmi2OK;
}
