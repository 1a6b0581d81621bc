//! Threads and clocks: the real-time loop, planner feeding, publisher, recorder.
