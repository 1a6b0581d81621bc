//! A simulated workpiece: a height field that a cutting edge removes, with a lag of one revolution.
//!
//! The field is the remaining height all round the circumference. A position that the edge passes is cut all
//! round only after a revolution. Therefore the field is lowered at the position where the tool was one
//! revolution ago, and the chip is the area between the edge and the field. Engaged depth and chip thickness
//! follow for any motion of the tool: entry under a lead angle, shoulders parallel to the edge, stops,
//! backing off.

use crate::blank::Blank;
use crate::cone::Cone;
use crate::law::CutLaw;
use crate::settings::TurningSettings;
use crate::tool::CuttingEdge;

/// Width of a cell of the field, mm.
const CELL_MM: f64 = 0.05;
/// Overlap below which nothing is cut, mm: rounding errors.
const OVERLAP_MM: f64 = 1e-9;
/// Height of stock above the end of the edge that is tolerated, mm: cells have a finite width.
const HOLDER_MM: f64 = 0.2;

/// The cut at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CutState {
    /// The true load.
    pub load: f64,
    /// Engaged depth of the edge, mm.
    pub depth_mm: f64,
    /// Mean chip thickness in the direction of feed, mm/rev.
    pub chip_mm: f64,
    /// Stock is higher than the end of the edge: it hits the holder.
    pub hits_holder: bool,
}

/// The workpiece.
#[derive(Clone, Debug)]
pub struct Workpiece {
    law: CutLaw,
    tool: CuttingEdge,
    blank: Blank,
    length_mm: f64,
    /// Height of the final contour at the end of the cut, mm.
    foot_mm: f64,
    cone: Option<Cone>,
    /// Mean height of the blank in each cell.
    raw: Vec<f64>,
    /// Minimum height of the edge over each cell for a whole revolution.
    cut: Vec<f64>,
    /// Positions of the tool over the last revolution.
    past: Vec<(f64, f64)>,
    next: usize,
    turn: f64,
    turn_per_step: f64,
}

impl Workpiece {
    /// A blank of a length, cut by a tool under a law; `steps_per_turn` calls of [`Workpiece::step`] are a
    /// revolution.
    #[must_use]
    pub fn new(blank: Blank, length_mm: f64, law: CutLaw, tool: CuttingEdge, steps_per_turn: f64) -> Self {
        let cells = ((length_mm / CELL_MM).round().clamp(1.0, 1e7)) as usize;
        let raw: Vec<f64> = (0..cells)
            .map(|i| blank.height_mm((i as f64 + 0.5) * CELL_MM))
            .collect();
        let steps = steps_per_turn.round().clamp(1.0, 1e6) as usize;
        let far = (-1e6, 1e6);
        Self {
            law,
            tool,
            blank,
            length_mm,
            foot_mm: 0.0,
            cone: None,
            cut: vec![f64::INFINITY; cells],
            raw,
            past: vec![far; steps],
            next: 0,
            turn: 0.0,
            turn_per_step: 1.0 / steps as f64,
        }
    }

    /// The blank of a cut. It extends after the end of the cut as far as the settings say.
    /// [`Workpiece::residual_mm`] and [`Workpiece::undercut_mm`] refer to the final contour: cylinder, cone,
    /// and the wall that the edge leaves.
    #[must_use]
    pub fn of_cut(blank: Blank, settings: &TurningSettings, law: CutLaw, steps_per_turn: f64) -> Self {
        // The highest tip and the edge ahead of it go no farther.
        let farthest_mm = settings.shoulder_mm() + 2.0 * settings.tool.overhang_mm();
        let whole_mm = settings.length_mm + settings.beyond_mm.min(farthest_mm);
        Self {
            length_mm: settings.length_mm,
            foot_mm: settings.height_at_end_mm(),
            cone: settings.cone,
            ..Self::new(blank, whole_mm, law, settings.tool, steps_per_turn)
        }
    }

    /// The final contour over a cell, mm: after the end of the cut the wall that the edge leaves.
    fn contour_mm(&self, cell: usize) -> f64 {
        let position_mm = cell_position(cell);
        let beyond_mm = position_mm - self.length_mm;
        if beyond_mm > 0.0 {
            return self.foot_mm + beyond_mm * self.tool.slope();
        }
        self.cone.map_or(0.0, |cone| cone.height_mm(position_mm))
    }

    /// Moves the tip to a position along the cut and a height, both in mm.
    pub fn step(&mut self, along_mm: f64, out_mm: f64) -> CutState {
        let before = self.past[self.next];
        let following = self.past[(self.next + 1) % self.past.len()];
        self.past[self.next] = (along_mm, out_mm);
        self.next = (self.next + 1) % self.past.len();
        self.turn = (self.turn + self.turn_per_step).fract();
        self.sweep(before, if self.past.len() == 1 { before } else { following });
        self.chip(along_mm, out_mm, before.0)
    }

    /// Lowers the field along a short distance of the tip.
    fn sweep(&mut self, from: (f64, f64), to: (f64, f64)) {
        if from.0 < -1e5 {
            return;
        }
        let parts = ((to.0 - from.0).abs() / CELL_MM).ceil().clamp(1.0, 1e4);
        let mut part = 1.0;
        while part <= parts {
            let fraction = part / parts;
            let (u, h) = (
                from.0 + fraction * (to.0 - from.0),
                from.1 + fraction * (to.1 - from.1),
            );
            let first = self.cell_at(u);
            let last = self.cell_at(u + self.tool.overhang_mm());
            for i in first..last {
                let edge = h + (cell_position(i) - u) * self.tool.slope();
                self.cut[i] = self.cut[i].min(edge);
            }
            part += 1.0;
        }
    }

    fn chip(&self, u: f64, h: f64, u_before: f64) -> CutState {
        let Some(raised) = self.blank.at_turn(self.turn) else {
            return CutState::default();
        };
        let first = self.cell_at(u_before.max(u - 10.0).min(u));
        let last = self.cell_at(u + self.tool.overhang_mm());
        let (mut area, mut depth, mut weighted, mut hits_holder) = (0.0, 0.0, 0.0, false);
        for i in first..last {
            let lead = cell_position(i) - u;
            let edge = h + lead.max(0.0) * self.tool.slope();
            let surface = self.cut[i].min((self.raw[i] + raised).max(0.0));
            let overlap = surface - edge;
            if overlap <= OVERLAP_MM {
                continue;
            }
            hits_holder |= surface > h + self.tool.reach_mm() + HOLDER_MM;
            area += overlap * CELL_MM;
            weighted += overlap * CELL_MM * self.blank.hardness(cell_position(i));
            if lead >= 0.0 {
                depth += CELL_MM * self.tool.slope();
            }
        }
        if area <= 0.0 {
            return CutState::default();
        }
        // At the start of a cut less than a cell is engaged.
        let depth = f64::max(depth, CELL_MM * self.tool.slope());
        let chip = area / depth;
        CutState {
            load: self.law.load(depth, chip) * weighted / area,
            depth_mm: depth,
            chip_mm: chip,
            hits_holder,
        }
    }

    fn cell_at(&self, u: f64) -> usize {
        ((u / CELL_MM).round().max(0.0) as usize).min(self.raw.len())
    }

    /// Mean remaining height at a position over the circumference, mm.
    #[must_use]
    pub fn height_mm(&self, along_mm: f64) -> f64 {
        let i = ((along_mm / CELL_MM) as usize).min(self.raw.len() - 1);
        self.raw[i].min(self.cut[i])
    }

    /// Maximum remaining stock, mm.
    #[must_use]
    pub fn residual_mm(&self) -> f64 {
        self.raw
            .iter()
            .zip(&self.cut)
            .enumerate()
            .map(|(cell, (raw, cut))| (raw + self.blank.runout_mm).min(*cut) - self.contour_mm(cell))
            .fold(0.0, f64::max)
    }

    /// Maximum depth of the tool below the final size, mm.
    #[must_use]
    pub fn undercut_mm(&self) -> f64 {
        self.cut
            .iter()
            .enumerate()
            .fold(0.0, |max, (cell, cut)| f64::max(max, self.contour_mm(cell) - cut))
    }

    /// Length of the cut, mm.
    #[must_use]
    pub fn length_mm(&self) -> f64 {
        self.length_mm
    }
}

/// Centre of a cell.
fn cell_position(cell: usize) -> f64 {
    (cell as f64 + 0.5) * CELL_MM
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAW: CutLaw = CutLaw {
        coefficient: 1467.0,
        depth_exponent: 1.0,
        feed_exponent: 0.75,
    };

    fn tool() -> CuttingEdge {
        CuttingEdge::new(60.0, 12.0).unwrap()
    }

    /// Feeds at `feed` mm/rev from `from` to `to` at a height; returns the cuts.
    fn feed(piece: &mut Workpiece, from: f64, to: f64, feed: f64, out: f64, steps: f64) -> Vec<CutState> {
        let mut cuts = Vec::new();
        let mut u = from;
        while u < to {
            u += feed / steps;
            cuts.push(piece.step(u, out));
        }
        cuts
    }

    #[test]
    fn a_steady_cut_has_the_load_of_the_law() {
        for (depth, feed_rev) in [(3.0, 0.4), (1.0, 0.7), (5.0, 0.2)] {
            let mut piece = Workpiece::new(Blank::uniform(depth), 40.0, LAW, tool(), 60.0);
            let cuts = feed(&mut piece, -8.0, 30.0, feed_rev, 0.0, 60.0);
            let tail = &cuts[cuts.len() - 600..];
            let mean = |of: &dyn Fn(&CutState) -> f64| tail.iter().map(of).sum::<f64>() / tail.len() as f64;
            assert!((mean(&|cut| cut.depth_mm) / depth - 1.0).abs() < 0.05, "{depth}");
            let load = mean(&|cut| cut.load) / LAW.load(depth, feed_rev);
            assert!((load - 1.0).abs() < 0.02, "{load} at {depth} x {feed_rev}");
        }
    }

    #[test]
    fn chip_vanishes_one_revolution_after_feed_stops() {
        let mut piece = Workpiece::new(Blank::uniform(3.0), 40.0, LAW, tool(), 60.0);
        let cuts = feed(&mut piece, -8.0, 20.0, 0.4, 0.0, 60.0);
        let steady = cuts[cuts.len() - 1].load;
        let half = (0..30).map(|_| piece.step(20.0, 0.0).load).last().unwrap();
        assert!(
            half > 0.5 * steady && half < 0.7 * steady,
            "half the chip is left: {half} of {steady}"
        );
        let after = (0..32).map(|_| piece.step(20.0, 0.0).load).last().unwrap();
        assert!(after < 0.01 * steady, "{after}");
    }

    #[test]
    fn the_depth_grows_with_the_lead_angle() {
        let mut piece = Workpiece::new(Blank::uniform(8.0), 60.0, LAW, tool(), 100.0);
        // The outer corner, 8 mm up, is met when the tip is 8/tan(60) before the face.
        let contact = -8.0 / 60.0_f64.to_radians().tan();
        let cuts = feed(&mut piece, contact - 1.0, contact + 2.0, 0.3, 0.0, 100.0);
        let at = |beyond: f64| cuts[((1.0 + beyond) / 0.003) as usize].depth_mm;
        assert_eq!(at(-0.2), 0.0);
        for beyond in [0.5, 1.0, 1.5] {
            let expected = beyond * 60.0_f64.to_radians().tan();
            assert!(
                (at(beyond) - expected).abs() < 0.2,
                "{} against {expected}",
                at(beyond)
            );
        }
    }

    #[test]
    fn stock_above_the_end_of_the_edge_hits_the_holder() {
        let hits = |height: f64| {
            let mut piece = Workpiece::new(Blank::uniform(height), 60.0, LAW, tool(), 60.0);
            feed(&mut piece, -8.0, 3.0, 0.4, 0.0, 60.0)
                .iter()
                .any(|cut| cut.hits_holder)
        };
        assert!(!hits(10.0));
        assert!(hits(11.0));
    }

    #[test]
    fn run_out_and_slots_come_once_a_turn() {
        let blank = Blank {
            runout_mm: 0.5,
            slots: vec![(0.25, 0.5)],
            ..Blank::uniform(3.0)
        };
        let mut piece = Workpiece::new(blank, 40.0, LAW, tool(), 80.0);
        let cuts = feed(&mut piece, -8.0, 25.0, 0.4, 0.0, 80.0);
        let turn = &cuts[cuts.len() - 80..];
        let idle = turn.iter().filter(|cut| cut.load == 0.0).count();
        assert!((19..=21).contains(&idle), "{idle} of 80");
        let max = turn.iter().map(|cut| cut.depth_mm).fold(0.0, f64::max);
        assert!((max - 3.5).abs() < 0.2, "{max}");
    }
}
