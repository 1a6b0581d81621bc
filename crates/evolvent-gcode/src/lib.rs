//! RS274/NGC: text in, a lazy stream of canonical commands out, errors with their place.
