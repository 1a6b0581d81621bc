/* The smallest bridge that drives could live behind: ideal axes that are where they shall be. A real one hands `at` to its
 * drives and reads back where they are. What else it must do stands in docs/bridges.md. */
#include "evolvent_bridge.h"
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

static uint64_t now_ns(void) {
    struct timespec t; clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
}
static int reachable(const evolvent_setpoint_t *s, const double *at, const double *speed, double h, int following) {
    int fits = 1; /* begin where the axes are and at rest, go on in steps that they can do; never with what is no number */
    for (int i = 0; i < EVOLVENT_AXES; i++) {
        const double v = s->velocity[i], step = s->position[i] - at[i], most = 20000.0 * h; /* twice the acceleration of the axes */
        const int goes_on = fabs(step - h * (speed[i] + v) / 2.0) < most * h / 4.0 && fabs(v - speed[i]) < most;
        fits &= !(s->axes_mask >> i & 1u) || (following ? goes_on : fabs(step) < 0.005 && fabs(v) < 1.0);
    }
    return fits;
}
int main(void) {
    const char *name = getenv("EVOLVENT_MACHINE_NAME"), *prefix = getenv("EVOLVENT_BUS_PREFIX");
    evolvent_bridge_t *bus = NULL; char error[256];
    while ((bus = evolvent_bridge_open(name, prefix, 1000, error, sizeof error)) == NULL) fprintf(stderr, "%s\n", error);
    const uint64_t period = evolvent_bridge_period_ns(bus), instance = now_ns();
    static evolvent_setpoint_t queue[1024], newest, s; /* sent ahead: kept until they are due */
    evolvent_feedback_t f = {.instance = instance, .bridge_state = EVOLVENT_BRIDGE_WAITING};
    double at[EVOLVENT_AXES] = {0}; unsigned first = 0, count = 0, locked = 0, quick = 0;
    for (uint64_t tick = instance, due = 0;; tick += period) {
        for (int got; (got = evolvent_bridge_receive(bus, &s)) != 0;) {
            quick = got == 1 ? s.power_request == EVOLVENT_POWER_QUICK_STOP : quick; /* at once, before it is due */
            if (got == 1 && s.due_time_ns + period - tick < 10000000000u && count < 1024 /* not late, hours ahead or backwards */
                && (s.sequence <= newest.sequence || s.due_time_ns > newest.due_time_ns)) queue[(first + count++) % 1024] = newest = s;
            else f.missed_setpoints++, f.note = got == 1 ? EVOLVENT_NOTE_LATE : EVOLVENT_NOTE_VERSION;
        }
        for (; count > 0 && queue[first].due_time_ns <= tick; first = (first + 1) % 1024, count--) {
            const evolvent_setpoint_t *q = &queue[first];
            if (f.sequence + 1 < q->sequence && due) f.missed_setpoints += (uint32_t)(q->sequence - f.sequence - 1);
            const double h = (double)(q->due_time_ns - due) * 1e-9;
            f.sequence = q->sequence, f.axes_mask = q->axes_mask, due = q->due_time_ns;
            locked = quick || q->power_request == EVOLVENT_POWER_QUICK_STOP || (locked && q->power_request != EVOLVENT_POWER_OFF);
            const int on = q->power_request == EVOLVENT_POWER_ON && !locked, renamed = q->datum != f.datum,
                      fits = reachable(q, at, f.velocity, h, f.bridge_state == EVOLVENT_BRIDGE_FOLLOWING);
            f.bridge_state = !on ? EVOLVENT_BRIDGE_OFF : fits || renamed ? EVOLVENT_BRIDGE_FOLLOWING : EVOLVENT_BRIDGE_HOLDING;
            for (int i = 0; i < EVOLVENT_AXES; i++) {
                f.status_word[i] = on ? 0x1237 : 0x0240;
                if (on && (fits || renamed)) at[i] = q->position[i], f.velocity[i] = renamed ? 0.0 : q->velocity[i];
            }
            f.datum = q->datum, f.fault_reset_done = q->fault_reset, f.phase_error_ns = (int64_t)(tick - due);
        }
        for (int i = 0; quick && i < EVOLVENT_AXES; i++) f.status_word[i] = 0x0240, f.bridge_state = EVOLVENT_BRIDGE_OFF, locked = 1;
        if (due + 10 * period < tick && f.bridge_state == EVOLVENT_BRIDGE_FOLLOWING) f.bridge_state = EVOLVENT_BRIDGE_HOLDING;
        for (int i = 0; i < EVOLVENT_AXES; i++) f.position[i] = at[i], f.velocity[i] *= f.bridge_state == EVOLVENT_BRIDGE_FOLLOWING;
        f.time_ns = now_ns(), evolvent_bridge_send(bus, &f);
        while (now_ns() < tick + period) usleep(200);
    }
}
