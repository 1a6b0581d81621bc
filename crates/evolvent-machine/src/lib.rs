//! The machine: axes, limits, configuration, and the rational control rate.
