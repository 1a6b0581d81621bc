//! A tool on two springs in a cut.

use evolvent_cutting::{ForceLaw, Section};
use nalgebra::{Complex, Matrix4, Schur, Vector4};

use crate::error::{ChatterError, number};

/// One principal axis of the tool's stiffness.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PrincipalAxis {
    /// Reduced mass, kg.
    pub mass_kg: f64,
    /// Damping, N s/m.
    pub damping_ns_m: f64,
    /// Stiffness, N/m.
    pub stiffness_n_m: f64,
}

impl PrincipalAxis {
    /// An axis with a damping ratio (fraction of critical damping).
    #[must_use]
    pub fn with_ratio(mass_kg: f64, stiffness_n_m: f64, damping_ratio: f64) -> Self {
        Self {
            mass_kg,
            damping_ns_m: 2.0 * damping_ratio * libm::sqrt(mass_kg * stiffness_n_m),
            stiffness_n_m,
        }
    }

    /// Natural frequency without damping, Hz.
    #[must_use]
    pub fn frequency_hz(&self) -> f64 {
        libm::sqrt(self.stiffness_n_m / self.mass_kg) / std::f64::consts::TAU
    }
}

/// A tool in a cut: the data of a [`Model`] except the force law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CuttingTool {
    /// The principal axes V1, V2 of the tool's stiffness.
    pub axes: [PrincipalAxis; 2],
    /// Angle from the machine's axes (y: away from the workpiece, z: against the main force) to the principal
    /// axes, degrees.
    pub beta_deg: f64,
    /// Cutting speed, m/min.
    pub speed_m_min: f64,
    /// Depth of cut, mm.
    pub depth_mm: f64,
    /// Feed, mm/rev.
    pub feed_mm_rev: f64,
    /// Radial over tangential force, Py / Pz.
    pub radial_ratio: f64,
    /// Speed below which the force law is not trusted, m/min.
    pub floor_m_min: f64,
}

/// The equations of motion (S. L. Leonov, E. V. Veglov, equation 1), with the signs that follow from
/// conjugate work:
///
/// ```text
/// m1 V1'' + G1 V1' + C1 V1 = Pz (lambda cos b - sin b)      y = V1 cos b - V2 sin b     Vf = V0 + z'
/// m2 V2'' + G2 V2' + C2 V2 = Pz (-lambda sin b - cos b)     z = V1 sin b + V2 cos b     tf = t0 - y
/// ```
///
/// There is no regenerative delay: the surface of the previous revolution has no effect.
///
/// A separate law for Py replaces `lambda Pz`.
#[derive(Clone, Copy, Debug)]
pub struct Model<'a> {
    tool: CuttingTool,
    law: Section<'a>,
    /// For Py, if it is not proportional to Pz.
    radial: Option<Section<'a>>,
    cos: f64,
    sin: f64,
    /// Force on each coordinate per N of Pz.
    direction: [f64; 2],
}

/// The force laws of a cut.
#[derive(Clone, Copy, Debug)]
pub struct Laws<'a> {
    /// Of the tangential force Pz.
    pub tangential: &'a ForceLaw,
    /// Of the radial force Py: the tangential force of this law is radial here. Without one, Py is
    /// [`CuttingTool::radial_ratio`] times Pz.
    pub radial: Option<&'a ForceLaw>,
}

impl<'a> From<&'a ForceLaw> for Laws<'a> {
    fn from(tangential: &'a ForceLaw) -> Self {
        Self {
            tangential,
            radial: None,
        }
    }
}

/// The state (V1, V2, V1', V2'), m and m/s.
pub type State = Vector4<f64>;

/// A force with its derivatives along the motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pull {
    pub(crate) force: f64,
    /// N per m of `y`.
    pub(crate) per_y: f64,
    /// N per m/s of `z'`.
    pub(crate) per_zdot: f64,
}

/// The steady cut and its small vibrations.
#[derive(Clone, Debug, PartialEq)]
pub struct Equilibrium {
    /// Deflections V1, V2, m.
    pub deflection_m: [f64; 2],
    /// Tangential force, N.
    pub force_n: f64,
    /// Modes of small vibration, the fastest growing first.
    pub modes: Vec<SmallMode>,
}

/// A mode of small vibration about the steady cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SmallMode {
    /// Growth (positive) or decay of the amplitude, 1/s.
    pub growth_per_s: f64,
    /// Frequency, Hz; 0 for a motion that does not oscillate.
    pub frequency_hz: f64,
}

impl Equilibrium {
    /// Growth of the fastest growing mode, 1/s.
    #[must_use]
    pub fn growth_per_s(&self) -> f64 {
        self.modes.first().map_or(f64::NAN, |mode| mode.growth_per_s)
    }
}

impl<'a> Model<'a> {
    /// Combines a tool and a force law.
    ///
    /// # Errors
    /// Numbers that are not finite or out of range, a speed at or below the floor, a feed at which the law
    /// has no force.
    pub fn new(tool: CuttingTool, laws: impl Into<Laws<'a>>) -> Result<Self, ChatterError> {
        let laws = laws.into();
        for axis in &tool.axes {
            number("mass_kg", axis.mass_kg, 1e-6, 1e6)?;
            number("damping_ns_m", axis.damping_ns_m, 0.0, 1e9)?;
            number("stiffness_n_m", axis.stiffness_n_m, 1.0, 1e13)?;
            number("natural frequency in Hz", axis.frequency_hz(), 0.1, 1e5)?;
        }
        number("beta_deg", tool.beta_deg, -360.0, 360.0)?;
        number("speed_m_min", tool.speed_m_min, 1e-3, 1e4)?;
        number("depth_mm", tool.depth_mm, 1e-4, 1e3)?;
        number("feed_mm_rev", tool.feed_mm_rev, 1e-4, 100.0)?;
        number("radial_ratio", tool.radial_ratio, 0.0, 10.0)?;
        number("floor_m_min", tool.floor_m_min, 1e-6, 1e4)?;
        if tool.speed_m_min <= tool.floor_m_min {
            return Err(ChatterError::BelowFloor {
                speed_m_min: tool.speed_m_min,
                floor_m_min: tool.floor_m_min,
            });
        }
        let beta = tool.beta_deg.to_radians();
        let (sin, cos) = (libm::sin(beta), libm::cos(beta));
        let law = laws.tangential.section(tool.feed_mm_rev)?;
        law.force(tool.speed_m_min, tool.depth_mm)?;
        let radial = match laws.radial {
            Some(law) => {
                let section = law.section(tool.feed_mm_rev)?;
                section.force(tool.speed_m_min, tool.depth_mm)?;
                Some(section)
            }
            None => None,
        };
        Ok(Self {
            tool,
            law,
            radial,
            cos,
            sin,
            direction: [tool.radial_ratio * cos - sin, -tool.radial_ratio * sin - cos],
        })
    }

    /// The same law with another tool or cut.
    ///
    /// # Errors
    /// As [`Model::new`]. The feed must be the same, because the law is a section at a feed.
    pub(crate) fn with_tool(&self, tool: CuttingTool) -> Result<Self, ChatterError> {
        number(
            "feed_mm_rev",
            tool.feed_mm_rev,
            self.tool.feed_mm_rev,
            self.tool.feed_mm_rev,
        )?;
        if tool.speed_m_min <= tool.floor_m_min {
            return Err(ChatterError::BelowFloor {
                speed_m_min: tool.speed_m_min,
                floor_m_min: tool.floor_m_min,
            });
        }
        self.law.force(tool.speed_m_min, tool.depth_mm)?;
        Ok(Self { tool, ..*self })
    }

    /// The tool and the cut.
    #[must_use]
    pub fn tool(&self) -> &CuttingTool {
        &self.tool
    }

    pub(crate) fn axes(&self) -> &[PrincipalAxis; 2] {
        &self.tool.axes
    }

    /// Force on each coordinate per N of tangential force.
    pub(crate) fn direction(&self) -> [f64; 2] {
        self.direction
    }

    /// `y` and `z` of V1 and V2.
    #[must_use]
    pub fn machine_axes(&self, v1: f64, v2: f64) -> (f64, f64) {
        (v1 * self.cos - v2 * self.sin, v1 * self.sin + v2 * self.cos)
    }

    /// Actual cutting speed in m/min and depth of cut in mm; the depth is negative out of contact.
    #[must_use]
    pub fn cut_at(&self, state: &State) -> (f64, f64) {
        let (y, _) = self.machine_axes(state[0], state[1]);
        let (_, z_dot) = self.machine_axes(state[2], state[3]);
        (
            self.tool.speed_m_min + 60.0 * z_dot,
            self.tool.depth_mm - 1000.0 * y,
        )
    }

    /// Whether Py has a separate law.
    pub(crate) fn has_radial_law(&self) -> bool {
        self.radial.is_some()
    }

    /// Tangential force at an actual speed (clamped to the floor) and depth (0 without contact).
    pub(crate) fn pull(&self, speed: f64, depth: f64) -> Result<Pull, ChatterError> {
        self.pull_of(&self.law, speed, depth)
    }

    /// Forces on V1 and V2, as in [`Model::pull`].
    pub(crate) fn pulls(&self, speed: f64, depth: f64) -> Result<[Pull; 2], ChatterError> {
        let tangential = self.pull(speed, depth)?;
        let Some(radial) = &self.radial else {
            return Ok(self.direction.map(|e| tangential.mixed(e, &tangential, 0.0)));
        };
        let radial = self.pull_of(radial, speed, depth)?;
        Ok([
            radial.mixed(self.cos, &tangential, -self.sin),
            radial.mixed(-self.sin, &tangential, -self.cos),
        ])
    }

    /// The forces of [`Model::pulls`] alone, N.
    pub(crate) fn forces_n(&self, speed: f64, depth: f64) -> Result<[f64; 2], ChatterError> {
        let tangential = self.force_of(&self.law, speed, depth)?;
        let Some(radial) = &self.radial else {
            return Ok(self.direction.map(|e| e * tangential));
        };
        let radial = self.force_of(radial, speed, depth)?;
        Ok([
            self.cos * radial - self.sin * tangential,
            -self.sin * radial - self.cos * tangential,
        ])
    }

    fn force_of(&self, law: &Section<'_>, speed: f64, depth: f64) -> Result<f64, ChatterError> {
        if depth <= 0.0 {
            return Ok(0.0);
        }
        Ok(law.tangential_n(self.floored(speed), depth)?)
    }

    /// NaN stays NaN, and the law rejects it.
    fn floored(&self, speed: f64) -> f64 {
        if speed < self.tool.floor_m_min {
            self.tool.floor_m_min
        } else {
            speed
        }
    }

    fn pull_of(&self, law: &Section<'_>, speed: f64, depth: f64) -> Result<Pull, ChatterError> {
        // The law rejects NaN.
        if depth <= 0.0 {
            return Ok(Pull {
                force: 0.0,
                per_y: 0.0,
                per_zdot: 0.0,
            });
        }
        let floored = speed < self.tool.floor_m_min;
        let force = law.force(self.floored(speed), depth)?;
        Ok(Pull {
            force: force.tangential_n,
            per_y: -1000.0 * force.per_depth,
            per_zdot: if floored { 0.0 } else { 60.0 * force.per_speed },
        })
    }

    /// Time derivative of a state.
    ///
    /// # Errors
    /// The law has no force there.
    pub fn derivative(&self, state: &State) -> Result<State, ChatterError> {
        let (speed, depth) = self.cut_at(state);
        Ok(self.accelerate(state, self.forces_n(speed, depth)?))
    }

    /// From the forces on V1 and V2.
    fn accelerate(&self, state: &State, forces: [f64; 2]) -> State {
        let acceleration = |i: usize| {
            let axis = &self.tool.axes[i];
            (forces[i] - axis.damping_ns_m * state[i + 2] - axis.stiffness_n_m * state[i]) / axis.mass_kg
        };
        State::new(state[2], state[3], acceleration(0), acceleration(1))
    }

    /// Time derivative of a state and its Jacobian.
    pub(crate) fn derivative_and_jacobian(
        &self,
        state: &State,
    ) -> Result<(State, Matrix4<f64>), ChatterError> {
        let (speed, depth) = self.cut_at(state);
        let pulls = self.pulls(speed, depth)?;
        let forces = pulls.map(|pull| pull.force);
        Ok((self.accelerate(state, forces), self.jacobian(&pulls)))
    }

    fn jacobian(&self, pulls: &[Pull; 2]) -> Matrix4<f64> {
        let mut jacobian = Matrix4::zeros();
        jacobian[(0, 2)] = 1.0;
        jacobian[(1, 3)] = 1.0;
        for (i, pull) in pulls.iter().enumerate() {
            let axis = &self.tool.axes[i];
            // By V1, V2, V1', V2'.
            let by = [
                pull.per_y * self.cos,
                -pull.per_y * self.sin,
                pull.per_zdot * self.sin,
                pull.per_zdot * self.cos,
            ];
            for (k, by) in by.iter().enumerate() {
                jacobian[(i + 2, k)] = by / axis.mass_kg;
            }
            jacobian[(i + 2, i)] -= axis.stiffness_n_m / axis.mass_kg;
            jacobian[(i + 2, i + 2)] -= axis.damping_ns_m / axis.mass_kg;
        }
        jacobian
    }

    /// The steady cut: deflection under a constant force, and its small vibrations.
    ///
    /// The force is the root of `P - Pz(V0, t0 - y(P))`, bracketed between 0 and twice the rigid tool's force
    /// and accurate to 1e-14 of it.
    ///
    /// # Errors
    /// No steady cut, or no force.
    pub fn equilibrium(&self) -> Result<Equilibrium, ChatterError> {
        if self.has_radial_law() {
            return self.equilibrium_by_depth();
        }
        let (speed, depth) = (self.tool.speed_m_min, self.tool.depth_mm);
        // Deflection of y per N.
        let compliance: [f64; 2] =
            std::array::from_fn(|i| self.direction[i] / self.tool.axes[i].stiffness_n_m);
        let (y_per_n, _) = self.machine_axes(compliance[0], compliance[1]);
        let none = ChatterError::NoEquilibrium { depth_mm: depth };
        let rigid = self.pull(speed, depth)?.force;
        let residual = |force: f64| -> Result<(f64, Pull), ChatterError> {
            let pull = self.pull(speed, depth - 1000.0 * y_per_n * force)?;
            Ok((force - pull.force, pull))
        };
        // If the tool is pushed out of the cut, the force is less than the rigid tool's; if it is pulled in,
        // more.
        let (mut low, mut high) = (0.0, rigid);
        let mut doublings = 0;
        while residual(high)?.0 < 0.0 {
            (low, high) = (high, 2.0 * high);
            doublings += 1;
            if doublings > 8 {
                return Err(none);
            }
        }
        let mut force = 0.5 * (low + high);
        let mut last = residual(force)?;
        for _ in 0..100 {
            if last.0 > 0.0 {
                high = force;
            } else {
                low = force;
            }
            // Newton's method while it stays within the bracket.
            let newton = force - last.0 / (1.0 - last.1.per_y * y_per_n);
            let next = if newton > low && newton < high {
                newton
            } else {
                0.5 * (low + high)
            };
            let change = (next - force).abs();
            force = next;
            last = residual(force)?;
            if change <= 1e-14 * rigid {
                break;
            }
        }
        let pulls = self.direction.map(|e| last.1.mixed(e, &last.1, 0.0));
        let modes = modes_of(&self.jacobian(&pulls));
        Ok(Equilibrium {
            deflection_m: [compliance[0] * force, compliance[1] * force],
            force_n: force,
            modes,
        })
    }
}

impl Pull {
    /// A weighted sum of this and another force.
    fn mixed(&self, own: f64, other: &Self, part: f64) -> Self {
        Self {
            force: own * self.force + part * other.force,
            per_y: own * self.per_y + part * other.per_y,
            per_zdot: own * self.per_zdot + part * other.per_zdot,
        }
    }
}

impl Model<'_> {
    /// The steady cut with laws for both forces: the actual depth that is consistent with the tool's
    /// deflection, by bisection to 1e-15 of it.
    fn equilibrium_by_depth(&self) -> Result<Equilibrium, ChatterError> {
        let (speed, depth) = (self.tool.speed_m_min, self.tool.depth_mm);
        let bent = |actual: f64| -> Result<([f64; 2], [Pull; 2]), ChatterError> {
            let pulls = self.pulls(speed, actual)?;
            let deflection = std::array::from_fn(|i| pulls[i].force / self.tool.axes[i].stiffness_n_m);
            Ok((deflection, pulls))
        };
        // The resulting depth minus the assumed one: falls through zero.
        let miss = |actual: f64| -> Result<f64, ChatterError> {
            let ([v1, v2], _) = bent(actual)?;
            Ok(depth - 1000.0 * self.machine_axes(v1, v2).0 - actual)
        };
        let (mut low, mut high) = (0.0, depth);
        let mut doublings = 0;
        while miss(high)? > 0.0 {
            (low, high) = (high, 2.0 * high);
            doublings += 1;
            if doublings > 8 {
                return Err(ChatterError::NoEquilibrium { depth_mm: depth });
            }
        }
        for _ in 0..100 {
            let middle = 0.5 * (low + high);
            if miss(middle)? > 0.0 {
                low = middle;
            } else {
                high = middle;
            }
            if high - low <= 1e-15 * depth {
                break;
            }
        }
        let (deflection_m, pulls) = bent(high)?;
        Ok(Equilibrium {
            deflection_m,
            force_n: self.pull(speed, high)?.force,
            modes: modes_of(&self.jacobian(&pulls)),
        })
    }

    /// Angular frequency and extra damping (proportional to the masses, 1/s) with which a mode of small
    /// vibration neither grows nor decays: its eigenvalue is on the imaginary axis. `None` for a mode that
    /// does not oscillate.
    pub(crate) fn balanced_mode(
        &self,
        rest: &Equilibrium,
        mode: &SmallMode,
    ) -> Result<Option<(f64, f64)>, ChatterError> {
        let [v1, v2] = rest.deflection_m;
        let (_, jacobian) = self.derivative_and_jacobian(&State::new(v1, v2, 0.0, 0.0))?;
        let omega = std::f64::consts::TAU * mode.frequency_hz;
        let mut value = Complex::new(mode.growth_per_s, omega);
        let mut extra = 0.0;
        // In small steps, so that two modes of similar frequency remain distinct.
        let whole = 2.0 * mode.growth_per_s;
        let steps = (whole.abs() / (0.01 * omega)).ceil().clamp(1.0, 50.0);
        for k in 1..=60_u32 {
            let before = extra;
            // The growth decreases by nearly half of the extra damping.
            extra = if f64::from(k) <= steps {
                whole * f64::from(k) / steps
            } else {
                extra + 2.0 * value.re
            };
            let mut damped = jacobian;
            damped[(2, 2)] -= extra;
            damped[(3, 3)] -= extra;
            let expected = value - Complex::new(0.5 * (extra - before), 0.0);
            let Some(schur) = Schur::try_new(damped, 1e-15, 1000) else {
                return Ok(None);
            };
            let nearest = schur
                .complex_eigenvalues()
                .iter()
                .copied()
                .min_by(|a, b| (a - expected).norm().total_cmp(&(b - expected).norm()));
            value = nearest.unwrap_or(expected);
            if f64::from(k) >= steps && value.re.abs() <= 1e-9 * omega {
                return Ok((value.im > 0.0).then_some((value.im, extra)));
            }
        }
        Ok(None)
    }
}

/// Eigenvalues with a frequency that is not negative, the fastest growing first.
fn modes_of(jacobian: &Matrix4<f64>) -> Vec<SmallMode> {
    let Some(schur) = Schur::try_new(*jacobian, 1e-15, 1000) else {
        return Vec::new();
    };
    let mut modes: Vec<SmallMode> = schur
        .complex_eigenvalues()
        .iter()
        .filter(|value: &&Complex<f64>| value.im >= 0.0)
        .map(|value| SmallMode {
            growth_per_s: value.re,
            frequency_hz: value.im / std::f64::consts::TAU,
        })
        .collect();
    modes.sort_by(|a, b| b.growth_per_s.total_cmp(&a.growth_per_s));
    modes
}
