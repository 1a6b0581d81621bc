//! Machine files from configurations of LinuxCNC.
//!
//! [`import`] reads an INI file with its includes and returns an [`Import`]: the text of a machine file, the
//! tool table and the parameter file in millimetres, and a [`Report`]. The report lists every value that was
//! chosen because LinuxCNC has none, and every line that was not carried over, with its reason.
//! [`Import::write`] writes the files.
//!
//! ```
//! let folder = std::env::temp_dir().join(format!("evolvent-import-example-{}", std::process::id()));
//! std::fs::create_dir_all(&folder)?;
//! let ini = folder.join("router.ini");
//! std::fs::write(
//!     &ini,
//!     "[KINS]\nKINEMATICS = trivkins\n[TRAJ]\nCOORDINATES = X\nLINEAR_UNITS = inch\n[JOINT_0]\nBACKLASH = 0.01\n\
//!      [AXIS_X]\nMIN_LIMIT = 0\nMAX_LIMIT = 10\nMAX_VELOCITY = 2\nMAX_ACCELERATION = 20\n",
//! )?;
//! let import = evolvent_import::import(&ini, "router")?;
//! let machine = evolvent_machine::Machine::parse(import.machine(), "router.toml")?;
//! assert_eq!(machine.axes[0].travel_max, 254.0);
//! assert!(import.machine().contains("backlash_mm = 0.254"));
//! std::fs::remove_dir_all(&folder)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! `evolvent-machine` has checked the machine file: anything that it rejects is an [`ImportError`] here.
//! Nothing is written before everything has been read. Not for the cycle: uses files and allocates.

mod axes;
mod error;
mod hal;
mod import;
mod ini;
mod reasons;
mod report;
mod screws;
mod settings;
mod spindles;
mod tables;
mod text;

pub use error::ImportError;
pub use import::{Import, import};
pub use report::{Chosen, Dropped, Report};
