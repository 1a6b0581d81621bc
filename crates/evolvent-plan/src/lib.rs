//! Blending, look-ahead and feed profile: path segments in, runs for the cycle out.
