//! Tests of what an analysis writes for the user.

mod bore_material;
mod turning_errors;
