//! The cutting process. Work in progress.
#![expect(
    clippy::neg_cmp_op_on_partial_ord,
    reason = "checks are written so that NaN fails them: not (x <= limit) refuses NaN, x > limit lets it pass"
)]
mod axis;
mod blank;
mod controller;
mod fixed;
mod law;
mod record;
mod regime;
mod sensor;
mod settings;
mod simulation;
mod state;
mod tool;
mod trail;
mod watch;
mod workpiece;

pub use axis::{AxisDrive, AxisPoint};
pub use blank::{Blank, BlankError};
pub use controller::{TurningController, TurningInputs, TurningOutput};
pub use fixed::FixedPasses;
pub use law::CutLaw;
pub use record::SizeRecord;
pub use regime::{BackOff, Regime, RegimeError, RegimeInput};
pub use sensor::{LoadSample, Sensor, SensorFault, SensorModel};
pub use settings::{OnThin, PassDepth, SettingsError, Strategy, TurningSettings};
pub use simulation::{Figures, Simulation, run_fixed};
pub use state::{Reason, Transition, TurningState};
pub use tool::{Tool, ToolError};
pub use watch::{LoadView, LoadWatch, SensorTrouble};
pub use workpiece::{CutNow, Workpiece};
