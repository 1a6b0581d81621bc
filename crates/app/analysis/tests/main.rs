//! Tests of the results that an analysis writes for the user.

mod bore_material;
mod turning_errors;
