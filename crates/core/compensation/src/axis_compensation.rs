//! The corrections of one axis.

use crate::design::AxisErrors;
use crate::direction::Direction;
use crate::screw_table::ScrewTable;
use crate::thermal_offset::ThermalOffset;
use crate::triple_average::TripleAverage;

/// Maximum iterations of the inverse. The slope of a correction is at most 0.05, so each iteration gains more
/// than a digit.
const ITERATIONS: usize = 16;

/// The corrections of one axis, one step per cycle.
#[derive(Clone, Debug)]
pub(crate) struct AxisCompensation {
    period_s: f64,
    table: Option<ScrewTable>,
    half_backlash: f64,
    direction: Direction,
    side: TripleAverage,
    thermal: Option<ThermalOffset>,
}

impl AxisCompensation {
    pub(crate) fn new(errors: &AxisErrors, n: usize, period_s: f64, position: f64) -> Self {
        Self {
            period_s,
            table: errors.table.clone(),
            half_backlash: 0.5 * errors.backlash,
            direction: Direction::new(errors.hysteresis, position),
            side: TripleAverage::new(n, 0),
            thermal: errors.thermal.map(|thermal| {
                ThermalOffset::new(thermal.max_offset_velocity, thermal.max_offset, period_s, n)
            }),
        }
    }

    pub(crate) fn set_thermal_offset(&mut self, offset: f64) {
        if let Some(thermal) = &mut self.thermal {
            thermal.aim(offset);
        }
    }

    pub(crate) fn rebase_position(&mut self, position: f64) {
        self.direction.rebase_position(position);
    }

    /// Corrects the position and its three derivatives by time.
    pub(crate) fn step(&mut self, y: [f64; 4]) -> [f64; 4] {
        let side = self.direction.update(y[0]);
        self.side.step(side);
        if let Some(thermal) = &mut self.thermal {
            thermal.step();
        }
        let b = self.by_time(self.side.at());
        let o = self.by_time(self.offset());
        let m = self
            .table
            .as_ref()
            .map_or([0.0; 4], |table| table.mean().at(y[0]));
        let g = self.half(y[0]);
        let [_, y1, y2, y3] = y;
        // The correction over the position for the present direction, by the chain rule; then the terms of
        // the changing direction.
        let c = [
            m[0] + b[0] * g[0],
            m[1] + b[0] * g[1],
            m[2] + b[0] * g[2],
            m[3] + b[0] * g[3],
        ];
        [
            y[0] + c[0] + o[0],
            y1 * (1.0 + c[1]) + b[1] * g[0] + o[1],
            y2 * (1.0 + c[1]) + c[2] * y1 * y1 + 2.0 * b[1] * g[1] * y1 + b[2] * g[0] + o[2],
            y3 * (1.0 + c[1])
                + 3.0 * c[2] * y1 * y2
                + c[3] * y1 * y1 * y1
                + 3.0 * b[1] * (g[2] * y1 * y1 + g[1] * y2)
                + 3.0 * b[2] * g[1] * y1
                + b[3] * g[0]
                + o[3],
        ]
    }

    /// The corrected position for the present direction.
    pub(crate) fn corrected(&self, y: f64) -> f64 {
        let m = self.table.as_ref().map_or(0.0, |table| table.mean().at(y)[0]);
        y + (m + self.side.at()[0] * self.half(y)[0]) + self.offset()[0]
    }

    /// The ideal position that belongs to a corrected one, for the present direction.
    pub(crate) fn ideal(&self, corrected: f64) -> f64 {
        let (b, o) = (self.side.at()[0], self.offset()[0]);
        let mut y = corrected;
        for _ in 0..ITERATIONS {
            let m = self.table.as_ref().map_or(0.0, |table| table.mean().at(y)[0]);
            let next = corrected - (m + b * self.half(y)[0] + o);
            if next == y {
                break;
            }
            y = next;
        }
        y
    }

    /// Half of the difference between the two directions.
    fn half(&self, position: f64) -> [f64; 4] {
        let curve = self.table.as_ref().and_then(ScrewTable::half_difference);
        let mut half = curve.map_or([0.0; 4], |curve| curve.at(position));
        half[0] += self.half_backlash;
        half
    }

    fn offset(&self) -> [f64; 4] {
        self.thermal.as_ref().map_or([0.0; 4], ThermalOffset::at)
    }

    fn by_time(&self, by_periods: [f64; 4]) -> [f64; 4] {
        let f = 1.0 / self.period_s;
        let [value, first, second, third] = by_periods;
        [value, first * f, second * (f * f), third * (f * f * f)]
    }
}
