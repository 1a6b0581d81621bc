//! Milling a hole along involutes.

use std::f64::consts::TAU;

use crate::involute::sin_less_angle_cos;
use crate::plane::{Planar, sin_cos_versin};
use crate::quadrature::invert;
use crate::{Arc, Axes, Curve, HoleError, Involute, MAX_COORDINATE, MAX_INVOLUTE_TURNS, Plane, Sense};

/// Most depths of one hole.
pub const MAX_DEPTHS: u32 = 10_000;

/// How far an end point that is computed here may lie off its involute, in mm. It is reached to 1e-12 mm.
const TOLERANCE_MM: f64 = 1e-6;

/// Whether the cutting edge moves with or against the feed, for a spindle that turns clockwise (M3).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Milling {
    /// With the feed: counter-clockwise round the inside of a hole (G3).
    #[default]
    Climb,
    /// Against the feed: clockwise round the inside of a hole (G2).
    Conventional,
}

impl Milling {
    /// The sense of the tool's path round the hole.
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
/// holes", Aerospace Technic and Technology 7 (104), 2013. Figures are those of the tool's centre. An involute
/// of n turns with base radius r = R / (2 pi n) (5) ends on the final circle of radius R with its tangent and
/// its curvature; only the curvature's derivative jumps there, by 1 / (r^2 phi^3).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hole {
    /// The plane of the hole.
    pub plane: Plane,
    /// The hole's centre in the plane in mm.
    pub centre_mm: [f64; 2],
    /// The hole's diameter in mm.
    pub diameter_mm: f64,
    /// The tool's diameter in mm.
    pub tool_diameter_mm: f64,
    /// Climb or conventional.
    pub milling: Milling,
}

/// Where an involute sets off.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum HoleStart {
    /// In the centre.
    #[default]
    Centre,
    /// At a point inside the final circle, in mm from the hole's centre.
    Point([f64; 2]),
    /// Where the involute's radius of curvature has this value in mm.
    CurvatureRadius(f64),
    /// So that the involute has this length in mm.
    Length(f64),
}

/// What a block of a hole's path is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Roughing, from the start out.
    Rough,
    /// Once round on the roughing circle.
    RoughCircle,
    /// Finishing: along an involute to the wall.
    Approach,
    /// Once round on the final circle.
    FinishCircle,
    /// Finishing: off the wall along the mirrored involute.
    Departure,
}

/// The six numbers of an involute block (12), (13), and of a circle block in the same form.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlockFigures {
    /// Length L in mm.
    pub length_mm: f64,
    /// Start x0, y0 in mm from the hole's centre.
    pub start_mm: [f64; 2],
    /// The angle psi by which the curve is turned, in rad, counter-clockwise.
    pub turn_rad: f64,
    /// Roll angle phi_0 at the start in rad; zero on a circle.
    pub start_roll_rad: f64,
    /// Radius of curvature at the start in mm.
    pub start_radius_mm: f64,
    /// Radius of curvature at the end in mm.
    pub end_radius_mm: f64,
}

/// One block of a hole's path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HoleBlock {
    /// What it is for.
    pub role: Role,
    /// The tool centre's path.
    pub curve: Curve,
    /// Its figures.
    pub figures: BlockFigures,
    /// Centre of the circle, or of the involute's base circle, in the plane in mm.
    pub centre_mm: [f64; 2],
    /// Radius of the circle, or of the involute's base circle, in mm.
    pub radius_mm: f64,
}

/// The blocks of one pass at one depth, and the numbers that they follow from.
#[derive(Clone, Debug, PartialEq)]
pub struct HolePass {
    /// The blocks in order; each starts where the one before ends.
    pub blocks: Vec<HoleBlock>,
    /// Radius R of the final circle (14) in mm.
    pub radius_mm: f64,
    /// Turns n of the whole involute (15).
    pub turns: u32,
    /// True radial pitch H = R / n (16) in mm.
    pub pitch_mm: f64,
    /// Base radius r = R / (2 pi n) (5) in mm.
    pub base_radius_mm: f64,
}

impl HolePass {
    /// Length of the whole pass in mm.
    #[must_use]
    pub fn length_mm(&self) -> f64 {
        self.blocks.iter().map(|block| block.figures.length_mm).sum()
    }

    /// Turns of the involute that are there: by so many its tangent turns from the start to the circle. Near to the
    /// paper's `(1 - |(x0, y0)| / R) n`, which takes distances for radii of curvature.
    #[must_use]
    pub fn visible_turns(&self) -> f64 {
        let involute = self.blocks.first().map(|block| block.figures.start_radius_mm);
        f64::from(self.turns) * (1.0 - involute.unwrap_or(0.0) / self.radius_mm)
    }
}

/// An involute in the hole's own system: centre in the origin, counter-clockwise.
struct Spiral {
    r: f64,
    phi: [f64; 2],
    psi: f64,
    /// The start, where it was given as a point: it stays that point, bit for bit.
    given: Option<Planar>,
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
        self.given
            .unwrap_or_else(|| turned(self.unturned(self.phi[0]), self.psi))
    }

    /// The base circle's centre: the whole curve is moved so that its evolute begins in the origin.
    fn base_centre(&self) -> Planar {
        turned([-self.r, 0.0], self.psi)
    }

    fn touch(&self, radius: f64) -> Planar {
        turned([0.0, -radius], self.psi)
    }

    /// (13).
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

/// The point mirrored at the line through the origin and `at`.
fn mirrored_at([x, y]: Planar, at: Planar) -> Planar {
    let [a, b] = at;
    let size = a * a + b * b;
    let (cos, sin) = ((a * a - b * b) / size, 2.0 * a * b / size);
    [x * cos + y * sin, x * sin - y * cos]
}

impl Hole {
    /// Roughing: an involute from the start out, of as many turns as the pitch asks for (15), or exactly
    /// `turns`, then once round, `allowance_mm` short of the wall. `at` holds the axes that rest: depth and so on.
    ///
    /// # Errors
    /// What is impossible, by name and with both numbers: see [`HoleError`].
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
    /// // 80 mm to the wall, 1 mm of allowance, at most 4 mm a turn: 20 turns.
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
        // A quotient that is whole but for rounding does not make another turn.
        let needed = (radius / pitch_mm - 1e-9).ceil().max(1.0);
        if turns.is_none() && needed > MAX_INVOLUTE_TURNS {
            let least_mm = radius / MAX_INVOLUTE_TURNS;
            return Err(HoleError::PitchTooSmall { pitch_mm, least_mm });
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

    /// Finishing: an involute approach of `turns` (one or two are usual) from the start, once round on the wall,
    /// and the mirrored departure. `allowance_mm` is what is left on the wall, usually nothing.
    ///
    /// # Errors
    /// What is impossible, by name and with both numbers: see [`HoleError`].
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

    /// Radius of the tool centre's final circle in mm (14).
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

    /// Base radius, roll angles and turn of the involute of `turns` that starts as asked.
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
            given: None,
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
                // (9). Its left side rises with the derivative r^2 phi (1 - cos phi) / distance, which vanishes once
                // a turn: bracketed.
                let distance = |phi: f64| {
                    let [x, y] = spiral.unturned(phi);
                    libm::hypot(x, y)
                };
                let slope = |phi: f64| r * r * phi * sin_cos_versin(phi).2 / distance(phi);
                let guess = end * distance_mm / radius;
                let phi = invert(&distance, &slope, distance_mm, end, guess);
                let [x, y] = spiral.unturned(phi);
                spiral.phi[0] = phi;
                spiral.given = Some(point);
                // The paper's (10) gives the cosine alone; this has the sign.
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

    /// From the hole's own system to the machine's: mirrored where the path runs clockwise.
    fn place(&self, point: Planar, at: &Axes) -> Axes {
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
        let touch = spiral.touch(radius);
        let (inner, base) = (spiral.start(), spiral.base_centre());
        let (from, to, base, radii) = if role == Role::Departure {
            (
                touch,
                mirrored_at(inner, touch),
                mirrored_at(base, touch),
                [radius, spiral.r * spiral.phi[0]],
            )
        } else {
            (inner, touch, base, [spiral.r * spiral.phi[0], radius])
        };
        let base = self.oriented(base);
        let centre_mm = [self.centre_mm[0] + base[0], self.centre_mm[1] + base[1]];
        let (start, end) = (self.place(from, at), self.place(to, at));
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
        let touch = spiral.touch(radius);
        let point = self.place(touch, at);
        let curve = Arc::new(self.plane, point, point, self.centre_mm, self.milling.sense(), 0)?;
        Ok(HoleBlock {
            role,
            curve: curve.into(),
            figures: BlockFigures {
                length_mm: TAU * radius,
                start_mm: self.oriented(touch),
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

/// The depths from `top_mm` down to `bottom_mm` in equal steps of at most `step_mm`: the first is one step
/// below the top, the last is the bottom.
///
/// # Errors
/// [`HoleError::Depth`] where the bottom is not below the top or the step is not positive,
/// [`HoleError::Depths`] where there would be too many.
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
