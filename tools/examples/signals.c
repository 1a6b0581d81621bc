/* Signals from C: input i of the machine is what its output i is, as if each output were wired to the input of its number; analog
 * inputs follow analog outputs. For trying programs with outputs and inputs where there is no machine, and as an example. */
#include "evolvent_bridge.h"
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

static uint64_t now_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
}

int main(void) {
    char error[256];
    const char *name = getenv("EVOLVENT_MACHINE_NAME"), *prefix = getenv("EVOLVENT_BUS_PREFIX");
    evolvent_bridge_t *bus = NULL;
    while ((bus = evolvent_bridge_open(name, prefix, 1000, error, sizeof error)) == NULL) fprintf(stderr, "%s\n", error);
    static evolvent_setpoint_t setpoint;
    static evolvent_machineoutputs_t outputs, next;
    static evolvent_machineinputs_t inputs;
    inputs.instance = now_ns();
    uint64_t heard = 0;
    for (int waiting = 0;;) {
        while (evolvent_bridge_receive(bus, &setpoint) > 0) {} /* of the drives' bridge */
        /* Outputs are sent ahead of the setpoint from which they count: one message is kept until it is due. */
        if (!waiting && (waiting = evolvent_bridge_receive_outputs(bus, &next) == 1)) heard = now_ns();
        if (waiting && next.due_time_ns <= now_ns()) outputs = next, waiting = 0;
        /* Without a message for 200 ms the safe values count, which are of no message. */
        const int silent = now_ns() - heard > 200000000u;
        inputs.outputs_sequence = silent ? 0 : outputs.sequence;
        inputs.digital_mask = outputs.digital_mask, inputs.digital = silent ? outputs.safe_digital : outputs.digital;
        inputs.analog_mask = outputs.analog_mask;
        for (int i = 0; i < 16; i++) inputs.analog[i] = silent ? outputs.safe_analog[i] : outputs.analog[i];
        inputs.sequence++, inputs.time_ns = now_ns();
        if (outputs.sequence > 0 && evolvent_bridge_send_inputs(bus, &inputs) != 0) fprintf(stderr, "%s\n", evolvent_bridge_error(bus));
        if (!waiting || next.due_time_ns > now_ns()) usleep(1000);
    }
}
