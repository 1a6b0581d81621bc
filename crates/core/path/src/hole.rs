//! Path synthesis for milling a hole along involutes.

use std::f64::consts::TAU;

use crate::involute::sin_less_angle_cos;
use crate::plane::{Planar, sin_cos_versin};
use crate::quadrature::invert;
use crate::{Arc, Axes, Curve, HoleError, Involute, MAX_COORDINATE, MAX_INVOLUTE_TURNS, Plane, Sense};

/// Maximum number of depth steps of one hole.
pub const MAX_DEPTHS: u32 = 10_000;

/// Permitted distance in mm of a computed end point from its involute. The actual distance is below 1e-12 mm.
const TOLERANCE_MM: f64 = 1e-6;

/// Direction of the cutting edge relative to the feed, for a spindle that turns clockwise (M3).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Milling {
    /// The cutting edge moves with the feed: counter-clockwise inside a hole (G3).
    #[default]
    Climb,
    /// The cutting edge moves against the feed: clockwise inside a hole (G2).
    Conventional,
}

impl Milling {
    /// The sense of the tool path inside the hole.
    #[must_use]
    pub const fn sense(self) -> Sense {
        match self {
            Self::Climb => Sense::CounterClockwise,
            Self::Conventional => Sense::Clockwise,
        }
    }
}

/// A hole and the tool that mills it.
///
/// After V. F. Sorokin, T. P. But, V. V. Kombarov, "Synthesis of involute paths of high-speed machining of
/// holes", Aerospace Technic and Technology 7 (104), 2013; numbers in parentheses are its equations. All
/// lengths refer to the tool centre. An involute of n turns with base radius r = R / (2 pi n) (5) ends on the
/// final circle of radius R with equal tangent and curvature; only the derivative of the curvature steps
/// there, by 1 / (r^2 phi^3).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hole {
    /// The plane of the hole.
    pub plane: Plane,
    /// Centre of the hole in the plane in mm.
    pub centre_mm: [f64; 2],
    /// Diameter of the hole in mm.
    pub diameter_mm: f64,
    /// Diameter of the tool in mm.
    pub tool_diameter_mm: f64,
    /// Climb or conventional milling.
    pub milling: Milling,
}

/// Where the involute starts.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum HoleStart {
    /// At the centre of the hole.
    #[default]
    Centre,
    /// At a point inside the final circle, in mm relative to the centre of the hole.
    Point([f64; 2]),
    /// Where the radius of curvature of the involute has this value in mm.
    CurvatureRadius(f64),
    /// Where the remaining involute has this length in mm.
    Length(f64),
}

/// The purpose of a block of a hole's path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Roughing involute, from the start outwards.
    Rough,
    /// One revolution on the roughing circle.
    RoughCircle,
    /// Finishing: involute to the wall.
    Approach,
    /// One revolution on the final circle.
    FinishCircle,
    /// Finishing: the mirrored involute away from the wall.
    Departure,
}

/// The six numbers of an involute block (12), (13), or of a circle block in the same form.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlockFigures {
    /// Length L in mm.
    pub length_mm: f64,
    /// Start x0, y0 in mm relative to the centre of the hole.
    pub start_mm: [f64; 2],
    /// Rotation psi of the curve in rad, counter-clockwise.
    pub turn_rad: f64,
    /// Roll angle phi_0 at the start in rad; 0 on a circle.
    pub start_roll_rad: f64,
    /// Radius of curvature at the start in mm.
    pub start_radius_mm: f64,
    /// Radius of curvature at the end in mm.
    pub end_radius_mm: f64,
}

/// One block of a hole's path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HoleBlock {
    /// The purpose of the block.
    pub role: Role,
    /// The path of the tool centre.
    pub curve: Curve,
    /// The numbers of the block as in the paper.
    pub figures: BlockFigures,
    /// Centre of the circle, or of the involute's base circle, in the plane in mm.
    pub centre_mm: [f64; 2],
    /// Radius of the circle, or of the involute's base circle, in mm.
    pub radius_mm: f64,
}

/// The blocks of one pass at one depth, and the numbers they follow from.
#[derive(Clone, Debug, PartialEq)]
pub struct HolePass {
    /// The blocks in order; each starts at the end of the previous one.
    pub blocks: Vec<HoleBlock>,
    /// Radius R of the final circle (14) in mm.
    pub radius_mm: f64,
    /// Number of turns n of the complete involute (15).
    pub turns: u32,
    /// True radial pitch H = R / n (16) in mm.
    pub pitch_mm: f64,
    /// Base radius r = R / (2 pi n) (5) in mm.
    pub base_radius_mm: f64,
}

impl HolePass {
    /// Length of the pass in mm.
    #[must_use]
    pub fn length_mm(&self) -> f64 {
        self.blocks.iter().map(|block| block.figures.length_mm).sum()
    }

    /// Number of turns of the involute that remain: the rotation of its tangent from the start to the circle.
    /// Close to the paper's `(1 - |(x0, y0)| / R) n`, which approximates radii of curvature by distances.
    #[must_use]
    pub fn visible_turns(&self) -> f64 {
        let involute = self.blocks.first().map(|block| block.figures.start_radius_mm);
        f64::from(self.turns) * (1.0 - involute.unwrap_or(0.0) / self.radius_mm)
    }

    /// Range of distances from the centre of the hole in mm at which a tool of `tool_diameter_mm` fits into
    /// what this roughing pass has cut: a later pass can move down there without cutting.
    ///
    /// The lower end is 0 for a pass from the centre. A pass from another point leaves a core within its
    /// first turn, which covers every direction at the distance that the involute has reached after it. A
    /// core narrower than the tool is cut with the turn.
    #[must_use]
    pub fn cleared_mm(&self, tool_diameter_mm: f64) -> [f64; 2] {
        let start_roll = self
            .blocks
            .first()
            .map_or(0.0, |block| block.figures.start_roll_rad);
        let last_roll = TAU * f64::from(self.turns);
        let reached_mm = from_centre(self.base_radius_mm, (start_roll + TAU).min(last_roll));
        let is_core_cut = start_roll == 0.0 || reached_mm <= 0.5 * tool_diameter_mm;
        [if is_core_cut { 0.0 } else { reached_mm }, self.radius_mm]
    }
}

/// Distance from the centre of the hole of an involute of base radius `r` at roll angle `phi`: the size of
/// (6), without cancellation.
fn from_centre(r: f64, phi: f64) -> f64 {
    let (sin, cos, versin) = sin_cos_versin(phi);
    r * libm::hypot(phi * sin - versin, sin_less_angle_cos(phi, sin, cos))
}

/// An involute in the coordinate system of the hole: centre at the origin, counter-clockwise.
struct Spiral {
    r: f64,
    phi: [f64; 2],
    psi: f64,
    /// The start if it was given as a point; it is kept bit for bit.
    exact_start: Option<Planar>,
}

impl Spiral {
    /// Equation (6) for psi = 0, with the terms grouped so that nothing cancels near the centre.
    fn unturned(&self, phi: f64) -> Planar {
        let (sin, cos, versin) = sin_cos_versin(phi);
        [
            self.r * (phi * sin - versin),
            self.r * sin_less_angle_cos(phi, sin, cos),
        ]
    }

    fn start(&self) -> Planar {
        self.exact_start
            .unwrap_or_else(|| turned(self.unturned(self.phi[0]), self.psi))
    }

    /// Centre of the base circle: the curve is shifted so that its evolute starts at the origin.
    fn base_centre(&self) -> Planar {
        turned([-self.r, 0.0], self.psi)
    }

    fn tangent_point(&self, radius: f64) -> Planar {
        turned([0.0, -radius], self.psi)
    }

    /// Length (13).
    fn length(&self) -> f64 {
        0.5 * self.r * (self.phi[1] - self.phi[0]) * (self.phi[1] + self.phi[0])
    }
}

fn turned([x, y]: Planar, angle: f64) -> Planar {
    let (sin, cos) = libm::sincos(angle);
    [x * cos - y * sin, x * sin + y * cos]
}

fn mirrored([x, y]: Planar) -> Planar {
    [x, -y]
}

/// The point mirrored across the line through the origin and `at`.
fn mirrored_at([x, y]: Planar, at: Planar) -> Planar {
    let [a, b] = at;
    let size = a * a + b * b;
    let (cos, sin) = ((a * a - b * b) / size, 2.0 * a * b / size);
    [x * cos + y * sin, x * sin - y * cos]
}

impl Hole {
    /// Plans roughing: an involute from the start outwards and one revolution on the roughing circle,
    /// `allowance_mm` short of the wall. The number of turns follows from the pitch (15) unless `turns` is
    /// given. `at` holds the axes that do not move, such as the depth.
    ///
    /// # Errors
    /// A [`HoleError`] that names the impossible value and its limit.
    /// ```
    /// use evolvent_path::{Axes, Hole, HoleStart, Milling, Plane};
    ///
    /// let hole = Hole {
    ///     plane: Plane::Xy,
    ///     centre_mm: [0.0, 0.0],
    ///     diameter_mm: 200.0,
    ///     tool_diameter_mm: 40.0,
    ///     milling: Milling::Climb,
    /// };
    /// let pass = hole.rough(4.0, None, 1.0, HoleStart::Centre, &Axes::zeros())?;
    /// // 80 mm to the wall, 1 mm allowance, at most 4 mm per turn: 20 turns.
    /// assert_eq!((pass.radius_mm, pass.turns), (79.0, 20));
    /// assert_eq!(pass.blocks.len(), 2);
    /// # Ok::<(), evolvent_path::HoleError>(())
    /// ```
    pub fn rough(
        &self,
        pitch_mm: f64,
        turns: Option<u32>,
        allowance_mm: f64,
        start: HoleStart,
        at: &Axes,
    ) -> Result<HolePass, HoleError> {
        let radius = self.path_radius_mm(allowance_mm)?;
        if !(pitch_mm > 0.0 && pitch_mm.is_finite()) {
            return Err(HoleError::Pitch { pitch_mm });
        }
        // A quotient that is integral up to rounding must not add a turn.
        let needed = (radius / pitch_mm - 1e-9).ceil().max(1.0);
        if turns.is_none() && needed > MAX_INVOLUTE_TURNS {
            let min_mm = radius / MAX_INVOLUTE_TURNS;
            return Err(HoleError::PitchTooSmall { pitch_mm, min_mm });
        }
        // At most 100 after the check above.
        let turns = turns.unwrap_or(needed as u32);
        let spiral = self.spiral(radius, turns, start)?;
        let pitch = radius / f64::from(turns);
        if pitch > self.tool_diameter_mm {
            let tool_mm = self.tool_diameter_mm;
            return Err(HoleError::PitchTooWide {
                pitch_mm: pitch,
                tool_mm,
            });
        }
        let blocks = vec![
            self.involute(Role::Rough, &spiral, radius, at)?,
            self.circle(Role::RoughCircle, &spiral, radius, at)?,
        ];
        Ok(pass(blocks, radius, turns, &spiral))
    }

    /// Plans finishing: an involute approach of `turns` (usually one or two) from the start, one revolution
    /// on the wall and the mirrored departure. `allowance_mm` is what remains on the wall, usually 0. `at`
    /// holds the axes that do not move.
    ///
    /// # Errors
    /// A [`HoleError`] that names the impossible value and its limit.
    pub fn finish(
        &self,
        turns: u32,
        allowance_mm: f64,
        start: HoleStart,
        at: &Axes,
    ) -> Result<HolePass, HoleError> {
        let radius = self.path_radius_mm(allowance_mm)?;
        let spiral = self.spiral(radius, turns, start)?;
        let blocks = vec![
            self.involute(Role::Approach, &spiral, radius, at)?,
            self.circle(Role::FinishCircle, &spiral, radius, at)?,
            self.involute(Role::Departure, &spiral, radius, at)?,
        ];
        Ok(pass(blocks, radius, turns, &spiral))
    }

    /// Radius in mm of the final circle of the tool centre (14).
    ///
    /// # Errors
    /// [`HoleError::Diameter`], [`HoleError::ToolTooWide`], [`HoleError::Allowance`], [`HoleError::Centre`].
    pub fn path_radius_mm(&self, allowance_mm: f64) -> Result<f64, HoleError> {
        let Self {
            diameter_mm,
            tool_diameter_mm,
            centre_mm,
            ..
        } = *self;
        let usable = |value: f64| value > 0.0 && value <= MAX_COORDINATE;
        if !(usable(diameter_mm) && usable(tool_diameter_mm)) {
            return Err(HoleError::Diameter {
                hole_mm: diameter_mm,
                tool_mm: tool_diameter_mm,
            });
        }
        if tool_diameter_mm >= diameter_mm {
            return Err(HoleError::ToolTooWide {
                hole_mm: diameter_mm,
                tool_mm: tool_diameter_mm,
            });
        }
        if !centre_mm.iter().all(|value| value.abs() <= MAX_COORDINATE) {
            return Err(HoleError::Centre {
                first_mm: centre_mm[0],
                second_mm: centre_mm[1],
            });
        }
        let limit_mm = 0.5 * (diameter_mm - tool_diameter_mm);
        if !(allowance_mm >= 0.0 && allowance_mm < limit_mm) {
            return Err(HoleError::Allowance {
                allowance_mm,
                limit_mm,
            });
        }
        Ok(limit_mm - allowance_mm)
    }

    /// Base radius, roll angles and rotation of the involute of `turns` turns with the requested start.
    fn spiral(&self, radius: f64, turns: u32, start: HoleStart) -> Result<Spiral, HoleError> {
        if turns == 0 || f64::from(turns) > MAX_INVOLUTE_TURNS {
            return Err(HoleError::Turns { turns });
        }
        let end = TAU * f64::from(turns);
        let r = radius / end;
        let mut spiral = Spiral {
            r,
            phi: [0.0, end],
            psi: 0.0,
            exact_start: None,
        };
        match start {
            HoleStart::Centre => {}
            HoleStart::Point(point) => {
                let point = if self.milling.sense() == Sense::Clockwise {
                    mirrored(point)
                } else {
                    point
                };
                let distance_mm = libm::hypot(point[0], point[1]);
                if !(distance_mm < radius - TOLERANCE_MM) {
                    return Err(HoleError::StartOutside {
                        distance_mm,
                        limit_mm: radius,
                    });
                }
                // (9). The left side has the derivative r^2 phi (1 - cos phi) / distance, which is never
                // negative but vanishes once per turn: Newton's method needs a bracket.
                let distance = |phi: f64| from_centre(r, phi);
                let slope = |phi: f64| r * r * phi * sin_cos_versin(phi).2 / distance(phi);
                let guess = end * distance_mm / radius;
                let phi = invert(&distance, &slope, distance_mm, end, guess);
                let [x, y] = spiral.unturned(phi);
                spiral.phi[0] = phi;
                spiral.exact_start = Some(point);
                // (10) gives only the cosine; atan2 gives the sign too.
                spiral.psi = libm::atan2(point[1], point[0]) - libm::atan2(y, x);
            }
            HoleStart::CurvatureRadius(start_radius_mm) => {
                if !(start_radius_mm >= 0.0 && start_radius_mm < radius - TOLERANCE_MM) {
                    return Err(HoleError::StartRadius {
                        radius_mm: start_radius_mm,
                        limit_mm: radius,
                    });
                }
                spiral.phi[0] = start_radius_mm / r;
            }
            HoleStart::Length(length_mm) => {
                let limit_mm = 0.5 * r * end * end;
                if !(length_mm > TOLERANCE_MM && length_mm <= limit_mm) {
                    return Err(HoleError::StartLength { length_mm, limit_mm });
                }
                spiral.phi[0] = (end * end - 2.0 * length_mm / r).max(0.0).sqrt();
            }
        }
        Ok(spiral)
    }

    /// Converts from the coordinate system of the hole to machine coordinates; mirrors where the path runs
    /// clockwise.
    fn machine_position(&self, point: Planar, at: &Axes) -> Axes {
        let point = self.oriented(point);
        let (first, second, _) = self.plane.axes();
        let mut axes = *at;
        axes[first] = self.centre_mm[0] + point[0];
        axes[second] = self.centre_mm[1] + point[1];
        axes
    }

    fn oriented(&self, point: Planar) -> Planar {
        if self.milling.sense() == Sense::Clockwise {
            mirrored(point)
        } else {
            point
        }
    }

    fn involute(&self, role: Role, spiral: &Spiral, radius: f64, at: &Axes) -> Result<HoleBlock, HoleError> {
        let tangent_point = spiral.tangent_point(radius);
        let (inner, base) = (spiral.start(), spiral.base_centre());
        let (from, to, base, radii) = if role == Role::Departure {
            (
                tangent_point,
                mirrored_at(inner, tangent_point),
                mirrored_at(base, tangent_point),
                [radius, spiral.r * spiral.phi[0]],
            )
        } else {
            (inner, tangent_point, base, [spiral.r * spiral.phi[0], radius])
        };
        let base = self.oriented(base);
        let centre_mm = [self.centre_mm[0] + base[0], self.centre_mm[1] + base[1]];
        let (start, end) = (self.machine_position(from, at), self.machine_position(to, at));
        let sense = self.milling.sense();
        let tolerance = TOLERANCE_MM.max(1e-12 * (centre_mm[0].abs() + centre_mm[1].abs()));
        let curve = Involute::new(self.plane, start, end, centre_mm, spiral.r, sense, tolerance)?;
        let roll = if role == Role::Departure {
            spiral.phi[1]
        } else {
            spiral.phi[0]
        };
        Ok(HoleBlock {
            role,
            curve: curve.into(),
            figures: BlockFigures {
                length_mm: spiral.length(),
                start_mm: self.oriented(from),
                turn_rad: self.milling.sense().sign() * spiral.psi,
                start_roll_rad: roll,
                start_radius_mm: radii[0],
                end_radius_mm: radii[1],
            },
            centre_mm,
            radius_mm: spiral.r,
        })
    }

    fn circle(&self, role: Role, spiral: &Spiral, radius: f64, at: &Axes) -> Result<HoleBlock, HoleError> {
        let tangent_point = spiral.tangent_point(radius);
        let point = self.machine_position(tangent_point, at);
        let curve = Arc::new(self.plane, point, point, self.centre_mm, self.milling.sense(), 0)?;
        Ok(HoleBlock {
            role,
            curve: curve.into(),
            figures: BlockFigures {
                length_mm: TAU * radius,
                start_mm: self.oriented(tangent_point),
                turn_rad: self.milling.sense().sign() * spiral.psi,
                start_roll_rad: 0.0,
                start_radius_mm: radius,
                end_radius_mm: radius,
            },
            centre_mm: self.centre_mm,
            radius_mm: radius,
        })
    }
}

fn pass(blocks: Vec<HoleBlock>, radius_mm: f64, turns: u32, spiral: &Spiral) -> HolePass {
    let pitch_mm = radius_mm / f64::from(turns);
    HolePass {
        blocks,
        radius_mm,
        turns,
        pitch_mm,
        base_radius_mm: spiral.r,
    }
}

/// The depths from `top_mm` down to `bottom_mm` in equal steps of at most `step_mm`. The first is one step
/// below the top, the last is the bottom.
///
/// # Errors
/// [`HoleError::Depth`] if the bottom is not below the top or the step is not positive, [`HoleError::Depths`]
/// if there are more than [`MAX_DEPTHS`].
pub fn depths_mm(top_mm: f64, bottom_mm: f64, step_mm: f64) -> Result<Vec<f64>, HoleError> {
    let depth = top_mm - bottom_mm;
    if !(depth > 0.0 && depth <= MAX_COORDINATE && step_mm > 0.0) {
        return Err(HoleError::Depth {
            top_mm,
            bottom_mm,
            step_mm,
        });
    }
    let count = (depth / step_mm - 1e-9).ceil().max(1.0);
    if count > f64::from(MAX_DEPTHS) {
        return Err(HoleError::Depths { count });
    }
    // At most MAX_DEPTHS after the check above.
    let count = count as u32;
    Ok((1..=count)
        .map(|i| {
            if i == count {
                bottom_mm
            } else {
                top_mm - depth * f64::from(i) / f64::from(count)
            }
        })
        .collect())
}
