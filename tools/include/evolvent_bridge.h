/* The bus for a drive bridge in C.
 *
 * Link with libevolvent_bus_c, which `cargo build --release -p evolvent-bus-c` makes:
 *
 *     cc -Itools/include bridge.c target/release/libevolvent_bus_c.a -lpthread -ldl -lm -lrt -o bridge
 *
 * A bridge belongs to the thread that opened it. No function waits, but for opening. The example is
 * tools/examples/bridge.c, for signals tools/examples/signals.c; what a bridge must do, docs/bridges.md. */
#ifndef EVOLVENT_BRIDGE_H
#define EVOLVENT_BRIDGE_H

#include "evolvent_bus.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct evolvent_bridge evolvent_bridge_t;

/* Finds the core of a machine, waiting so long for it. `prefix` is the core's --bus-prefix, or NULL. Returns NULL where
 * it fails, and writes why into `error`, cut to `error_size` bytes (both may be 0). */
evolvent_bridge_t *evolvent_bridge_open(const char *machine_name, const char *prefix, uint32_t wait_ms, char *error,
                                        size_t error_size);

/* The oldest setpoint not taken yet: 1 and the setpoint, 0 if there is none, -1 if the bus is broken (close it and open it
 * again), -2 if a setpoint of another interface version came and was dropped. */
int evolvent_bridge_receive(evolvent_bridge_t *bridge, evolvent_setpoint_t *setpoint);

/* Sends an answer; fills in version and size. 0, or -1 if it did not leave. */
int evolvent_bridge_send(evolvent_bridge_t *bridge, const evolvent_feedback_t *feedback);

/* The oldest change of the machine's outputs not taken yet, from those in force on; returns as evolvent_bridge_receive. A message is
 * complete in itself, and counts from its `due_time_ns` on. */
int evolvent_bridge_receive_outputs(evolvent_bridge_t *bridge, evolvent_machineoutputs_t *outputs);

/* Sends the machine's inputs; fills in version and size. At every change, and at least four times in the machine file's
 * signals.input_timeout_ms. 0, or -1 if they did not leave. */
int evolvent_bridge_send_inputs(evolvent_bridge_t *bridge, const evolvent_machineinputs_t *inputs);

/* The core's period in ns, and the letters of its axes in order, like "XYZ". */
uint64_t evolvent_bridge_period_ns(const evolvent_bridge_t *bridge);
const char *evolvent_bridge_axes(const evolvent_bridge_t *bridge);

/* What went wrong last. */
const char *evolvent_bridge_error(const evolvent_bridge_t *bridge);

void evolvent_bridge_close(evolvent_bridge_t *bridge);

#ifdef __cplusplus
}
#endif

#endif
