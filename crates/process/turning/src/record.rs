//! The controller's knowledge of the stock from its own passes.

use crate::cone::Cone;

/// Maximum number of cells of a record.
const CELLS: usize = 4096;
/// Fraction of the maximum height from which stock counts as level with it.
const ABOUT: f64 = 0.75;
/// Minimum fraction of level positions in level stock.
const LEVEL_FRACTION: f64 = 0.8;
/// Minimum width of a cell, mm.
const CELL_MM: f64 = 0.1;

/// Maximum height of the remaining stock at each position, mm above the final size, and how reliably it is
/// known.
///
/// Memory is allocated once; everything but [`SizeRecord::new`] and [`SizeRecord::with_shoulder`] is
/// real-time safe.
///
/// ```
/// use evolvent_turning::SizeRecord;
/// // 20 mm, an edge at 60 degrees that leads by 6 mm.
/// let mut record = SizeRecord::new(20.0, 3.0_f64.sqrt(), 6.0);
/// for tenth in -20..=100 {
///     record.sweep(0.1 * f64::from(tenth), 2.0, true, true);
/// }
/// assert_eq!(record.at(5.0).top_mm, 2.0);
/// assert_eq!(record.first_above(2.5), Some(10.0));
/// ```
#[derive(Clone, Debug)]
pub struct SizeRecord {
    cells: Vec<Cell>,
    cell_mm: f64,
    slope: f64,
    overhang_mm: f64,
    /// End of the last sweep.
    swept_to: f64,
}

/// One position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// Maximum height of the stock here, mm; infinite where no part of the edge has been.
    pub top_mm: f64,
    /// Height at which the shoulder of an abandoned pass is assumed to continue until the tip has been here,
    /// mm: no part of the edge has confirmed it.
    pub shoulder_mm: f64,
    /// The tip has passed.
    pub known: bool,
    /// The tip has passed, and a load was felt.
    pub felt: bool,
    /// The tip has passed and was in stock, which remains below it: at least `min_mm` of stock is here.
    pub sure: bool,
    /// Height that may remain at the end, mm: above 0 on a cone and on the wall.
    pub final_mm: f64,
    /// After the end of the cut, on the wall that the edge leaves along itself. At the final size the tip
    /// does not come here, so the record is complete with what the edge has left.
    pub is_wall: bool,
    /// Minimum height of the stock where it is sure, mm. Below `top_mm` where the edge has been for less than
    /// a revolution.
    pub min_mm: f64,
}

/// A position of which nothing is known.
const NOTHING: Cell = Cell {
    top_mm: f64::INFINITY,
    shoulder_mm: f64::INFINITY,
    known: false,
    felt: false,
    sure: false,
    final_mm: 0.0,
    is_wall: false,
    min_mm: 0.0,
};

impl SizeRecord {
    /// An empty record over a length. The edge rises by `slope` mm per mm of lead, over `overhang_mm`.
    #[must_use]
    pub fn new(length_mm: f64, slope: f64, overhang_mm: f64) -> Self {
        let cells = (length_mm / CELL_MM).ceil().clamp(1.0, CELLS as f64);
        Self {
            cells: vec![NOTHING; cells as usize],
            cell_mm: length_mm / cells,
            slope,
            overhang_mm,
            swept_to: f64::NEG_INFINITY,
        }
    }

    /// Adds a cone on which `tolerance_mm` may be left.
    #[must_use]
    pub fn with_cone(mut self, cone: Option<Cone>, tolerance_mm: f64) -> Self {
        if let Some(cone) = cone {
            for (i, cell) in self.cells.iter_mut().enumerate() {
                let height = cone.height_mm((i + 1) as f64 * self.cell_mm);
                cell.final_mm = if height > 0.0 { height + tolerance_mm } else { 0.0 };
            }
        }
        self
    }

    /// Adds the stock after the end of the cut, over a length. The final contour there begins with `foot_mm`
    /// and rises as a wall along the edge.
    #[must_use]
    pub fn with_shoulder(mut self, shoulder_mm: f64, foot_mm: f64) -> Self {
        // No cell ends beyond the edge of the last pass, which would not reach its end.
        let more = (shoulder_mm / self.cell_mm - 1e-6)
            .floor()
            .clamp(0.0, CELLS as f64) as usize;
        for i in 1..=more {
            self.cells.push(Cell {
                final_mm: foot_mm + i as f64 * self.cell_mm * self.slope,
                is_wall: true,
                ..NOTHING
            });
        }
        self
    }

    /// The edge has cut over a whole revolution up to a position of the tip, at a height; `felt` and `sure`
    /// as in `Cell`. Only forward motion counts.
    pub fn sweep(&mut self, along_mm: f64, out_mm: f64, felt: bool, sure: bool) {
        let before = self.swept_to;
        self.swept_to = along_mm;
        if along_mm < before || !before.is_finite() {
            return;
        }
        let out_mm = out_mm.max(0.0);
        // Cells whose far end has been passed.
        let (first, tip) = (self.ends_before(before), self.ends_before(along_mm));
        let last = self.ends_before(along_mm + self.overhang_mm);
        for (i, cell) in self.cells.iter_mut().enumerate().take(last).skip(first) {
            let lead = ((i + 1) as f64 * self.cell_mm - along_mm).max(0.0);
            cell.top_mm = cell.top_mm.min(out_mm + lead * self.slope);
            cell.min_mm = cell.min_mm.min(cell.top_mm);
            if i < tip {
                (cell.known, cell.felt, cell.sure) = (true, felt, sure);
                (cell.min_mm, cell.shoulder_mm) = (cell.top_mm, f64::INFINITY);
            }
        }
    }

    /// Marks stock as sure that the present sweep has passed from a position on while it felt a load.
    pub fn confirm_from(&mut self, along_mm: f64) {
        let (first, tip) = (self.ends_before(along_mm), self.ends_before(self.swept_to));
        for cell in self.cells.iter_mut().take(tip).skip(first) {
            cell.sure |= cell.known && cell.felt;
        }
    }

    fn ends_before(&self, along_mm: f64) -> usize {
        ((along_mm + 1e-9) / self.cell_mm).floor().max(0.0) as usize
    }

    /// The next sweep starts elsewhere. The tip has been at a height up to `along_mm`, but for less than a
    /// revolution: the stock there, and under the edge, is not sure.
    pub fn lift(&mut self, along_mm: f64, out_mm: f64) {
        if self.swept_to.is_finite() {
            let (first, tip) = (self.ends_before(self.swept_to), self.ends_before(along_mm) + 1);
            let last = self.ends_before(along_mm + self.overhang_mm);
            for (i, cell) in self.cells.iter_mut().enumerate().take(last.max(tip)).skip(first) {
                cell.sure &= i >= tip;
                let lead = ((i + 1) as f64 * self.cell_mm - along_mm).max(0.0);
                cell.min_mm = cell.min_mm.min(out_mm + lead * self.slope);
            }
        }
        self.swept_to = f64::NEG_INFINITY;
    }

    /// A pass was abandoned where stock of a height was felt. Its shoulder remains there, parallel to the
    /// edge. With `sure` it is certain up to where the shoulder has that height.
    pub fn leave_shoulder(&mut self, along_mm: f64, height_mm: f64, sure: bool) {
        let (first, last) = (
            self.ends_before(along_mm),
            self.ends_before(along_mm + 2.0 * self.overhang_mm),
        );
        let sure_to = self.ends_before(along_mm + height_mm.max(0.0) / self.slope) + 2;
        for (i, cell) in self.cells.iter_mut().enumerate().take(last).skip(first) {
            if !cell.known {
                cell.shoulder_mm = cell.shoulder_mm.min(height_mm);
                cell.felt = true;
                cell.sure |= sure && i <= sure_to;
                cell.min_mm = cell.top_mm.min(cell.shoulder_mm);
            }
        }
    }

    /// Marks the positions that the tip has passed from a position on as unknown.
    pub fn forget_from(&mut self, along_mm: f64) {
        let first = self.ends_before(along_mm);
        for cell in self.cells.iter_mut().skip(first) {
            (cell.known, cell.felt, cell.sure) = (false, false, false);
            cell.shoulder_mm = f64::INFINITY;
            if cell.is_wall {
                cell.top_mm = f64::INFINITY;
            }
        }
    }

    /// Whether there is a position of the cut that the tip has not passed.
    #[must_use]
    pub fn has_unknown(&self) -> bool {
        self.cells.iter().any(|cell| !cell.known && !cell.is_wall)
    }

    /// Maximum height in a cell: infinite where it is unknown.
    fn max(cell: &Cell) -> f64 {
        if cell.known || cell.is_wall {
            cell.top_mm
        } else {
            f64::INFINITY
        }
    }

    /// Whether stock in a cell may exceed a height and its final height.
    fn is_above(cell: &Cell, height_mm: f64) -> bool {
        Self::max(cell) > height_mm.max(cell.final_mm)
    }

    /// The first position where stock may exceed `height_mm` and its final height; `None` if there is none.
    #[must_use]
    pub fn first_above(&self, height_mm: f64) -> Option<f64> {
        let cell = self
            .cells
            .iter()
            .position(|cell| Self::is_above(cell, height_mm))?;
        Some(cell as f64 * self.cell_mm)
    }

    /// The end of the last position where stock may exceed `height_mm` and its final height.
    #[must_use]
    pub fn last_above(&self, height_mm: f64) -> Option<f64> {
        let cell = self
            .cells
            .iter()
            .rposition(|cell| Self::is_above(cell, height_mm))?;
        Some((cell + 1) as f64 * self.cell_mm)
    }

    /// Maximum height of the known stock above its final height.
    #[must_use]
    pub fn highest_known_mm(&self) -> f64 {
        self.known()
            .filter(|cell| cell.top_mm > cell.final_mm)
            .fold(0.0, |max, cell| f64::max(max, cell.top_mm))
    }

    fn known(&self) -> impl Iterator<Item = &Cell> {
        self.cells.iter().filter(|cell| cell.known)
    }

    /// Whether nothing is known.
    #[must_use]
    pub fn is_blank(&self) -> bool {
        self.known().next().is_none()
    }

    /// The record at a position; air before the start and after the end.
    #[must_use]
    pub fn at(&self, along_mm: f64) -> Cell {
        let air = Cell {
            top_mm: 0.0,
            shoulder_mm: f64::INFINITY,
            known: true,
            felt: false,
            sure: false,
            final_mm: 0.0,
            is_wall: false,
            min_mm: 0.0,
        };
        if along_mm < 0.0 {
            return air;
        }
        self.cells
            .get((along_mm / self.cell_mm) as usize)
            .copied()
            .unwrap_or(air)
    }

    /// Depth of the cut of an edge with its tip at a height, `ahead_mm` after a position. Positions where no
    /// load was felt do not count, and with `sure` neither do those that are not sure.
    #[must_use]
    pub fn depth_ahead_mm(&self, along_mm: f64, out_mm: f64, ahead_mm: f64, sure: bool) -> f64 {
        let at = along_mm + ahead_mm;
        let first = (along_mm.min(at).max(0.0) / self.cell_mm) as usize;
        let last = ((at + self.overhang_mm).max(0.0) / self.cell_mm).ceil() as usize;
        let mut deepest = 0.0;
        for (i, cell) in self.cells.iter().enumerate().take(last).skip(first) {
            let top_mm = cell.top_mm.min(cell.shoulder_mm);
            let above = if sure { cell.min_mm } else { top_mm } - out_mm;
            let lead = (i + 1) as f64 * self.cell_mm - at;
            if (cell.sure || (cell.felt && !sure)) && above > lead * self.slope {
                deepest = f64::max(deepest, above);
            }
        }
        deepest
    }

    /// Maximum depth of cut within the next `ahead_mm` for a tip at a height: infinite where no part of the
    /// edge has been. `None` where a load was felt, so that the depth is better known.
    #[must_use]
    pub fn bound_ahead_mm(&self, along_mm: f64, out_mm: f64, ahead_mm: f64) -> Option<f64> {
        let first = (along_mm.max(0.0) / self.cell_mm) as usize;
        let last = ((along_mm + ahead_mm + self.overhang_mm).max(0.0) / self.cell_mm).ceil() as usize;
        let mut deepest = 0.0;
        for cell in self.cells.iter().take(last).skip(first) {
            if cell.felt {
                return None;
            }
            deepest = f64::max(deepest, cell.top_mm - out_mm);
        }
        Some(deepest)
    }

    /// Maximum height of the stock between two positions, mm. Infinite where no part of the edge has been,
    /// where the shoulder of an abandoned pass is only assumed, and after the wall that the edge leaves.
    #[must_use]
    pub fn highest_mm(&self, from_mm: f64, to_mm: f64) -> f64 {
        let first = (from_mm.max(0.0) / self.cell_mm) as usize;
        let last = (to_mm.max(0.0) / self.cell_mm).ceil() as usize;
        if last > self.cells.len() && self.cells.last().is_some_and(|cell| cell.is_wall) {
            return f64::INFINITY;
        }
        let cells = self.cells.iter().take(last).skip(first);
        cells.fold(0.0, |max, cell| {
            let is_taken = cell.felt && !cell.known;
            f64::max(max, if is_taken { f64::INFINITY } else { cell.top_mm })
        })
    }

    /// Whether most of the known stock of the cut above a height is nearly as high as its highest point.
    #[must_use]
    pub fn is_level(&self, height_mm: f64) -> bool {
        let above = || {
            self.known()
                .filter(|cell| !cell.is_wall)
                .map(|cell| cell.top_mm - height_mm.max(cell.final_mm))
                .filter(|above| *above > 0.0)
        };
        let highest = above().fold(0.0, f64::max);
        let (all, high) = above().fold((0_usize, 0_usize), |(all, high), above| {
            (all + 1, high + usize::from(above >= ABOUT * highest))
        });
        high as f64 >= LEVEL_FRACTION * all as f64
    }

    /// The last position of a tip at a height before the stock that starts at `from_mm`, at which the whole
    /// edge is clear of it.
    #[must_use]
    pub fn clear_place_mm(&self, from_mm: f64, out_mm: f64) -> f64 {
        let mut position = from_mm;
        let first = (from_mm.max(0.0) / self.cell_mm) as usize;
        let last = ((from_mm + self.overhang_mm).max(0.0) / self.cell_mm).ceil() as usize;
        for (i, cell) in self.cells.iter().enumerate().take(last).skip(first) {
            let above = (Self::max(cell).min(cell.top_mm.max(0.0)) - out_mm).max(0.0);
            let lead = if cell.known || cell.is_wall {
                above / self.slope
            } else {
                f64::INFINITY
            };
            if above > 0.0 {
                position = position.min(i as f64 * self.cell_mm - lead.min(self.overhang_mm));
            }
        }
        position
    }

    /// The first position from `along_mm` on where stock may exceed `height_mm`; `None` if there is none.
    #[must_use]
    pub fn next_above(&self, along_mm: f64, height_mm: f64) -> Option<f64> {
        let first = (along_mm.max(0.0) / self.cell_mm) as usize;
        let rest = self.cells.get(first..)?;
        let cell = rest.iter().position(|cell| Self::max(cell) > height_mm)?;
        Some((first + cell) as f64 * self.cell_mm)
    }

    /// Cells with the positions of their centres, for reports.
    pub fn cells(&self) -> impl Iterator<Item = (f64, &Cell)> + '_ {
        self.cells
            .iter()
            .enumerate()
            .map(|(i, cell)| ((i as f64 + 0.5) * self.cell_mm, cell))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(length_mm: f64) -> SizeRecord {
        SizeRecord::new(length_mm, 3.0_f64.sqrt(), 6.0)
    }

    #[test]
    fn passed_stock_is_known_and_edge_contact_bounds_it() {
        let mut record = record(20.0);
        assert!(record.is_blank());
        for i in -20..=100 {
            record.sweep(f64::from(i) * 0.1, 3.0, true, true);
        }
        record.lift(0.0, 3.0);
        for i in 40..=60 {
            record.sweep(f64::from(i) * 0.1, 1.0, true, false);
        }
        let top = |position: f64| record.at(position).top_mm;
        assert_eq!((top(2.05), top(5.05), top(9.05)), (3.0, 1.0, 3.0));
        assert!(record.at(2.0).sure && !record.at(5.0).sure && !record.at(12.0).known);
        // The edge leads: 1 mm before the last position of the tip it is higher by tan(60) mm.
        assert!((top(6.95) - (1.0 + 3.0_f64.sqrt())).abs() < 1e-9);
        assert!((top(10.95) - (3.0 + 3.0_f64.sqrt())).abs() < 1e-9);
        assert!(top(18.0).is_infinite());
        assert_eq!(record.first_above(0.5), Some(0.0));
        assert_eq!(record.highest_known_mm(), 3.0);
    }

    #[test]
    fn stock_height_bound_is_finite_only_after_an_edge() {
        let mut record = record(20.0);
        for i in -20..=100 {
            record.sweep(f64::from(i) * 0.1, 1.0, true, false);
        }
        assert_eq!(record.highest_mm(0.0, 10.0), 1.0);
        assert!((record.highest_mm(0.0, 12.0) - (1.0 + 2.0 * 3.0_f64.sqrt())).abs() < 1e-9);
        assert!(record.highest_mm(0.0, 17.0).is_infinite());
        // It is unknown whether the shoulder continues.
        record.leave_shoulder(10.0, 2.0, false);
        assert!(record.highest_mm(0.0, 12.0).is_infinite());
        assert!(!record.at(4.0).sure);
        record.confirm_from(3.0);
        assert!(record.at(4.0).sure && !record.at(2.0).sure && !record.at(11.0).sure);
    }

    #[test]
    fn wall_at_the_end_has_the_shape_the_edge_leaves() {
        let (slope, tolerance_mm) = (3.0_f64.sqrt(), 0.02);
        let mut record = record(20.0).with_shoulder(4.0 / slope, tolerance_mm);
        let pass = |record: &mut SizeRecord, end_mm: f64, out_mm: f64| {
            record.lift(0.0, out_mm);
            for i in -70..=(10.0 * end_mm).floor() as i32 {
                record.sweep(f64::from(i) * 0.1, out_mm, true, true);
            }
            record.sweep(end_mm, out_mm, true, true);
        };
        assert!(record.has_unknown() && record.first_above(tolerance_mm) == Some(0.0));
        // At 2 mm above the final size, the pass ends where its wall is that of the last one.
        let end_mm = 20.0 + 2.0 / slope;
        pass(&mut record, end_mm, 2.0);
        assert!(!record.has_unknown());
        // The stock is level: the wall does not count.
        assert!(record.is_level(tolerance_mm));
        let left_mm = record.last_above(tolerance_mm).unwrap();
        assert!((end_mm - 0.2..=end_mm).contains(&left_mm), "{left_mm}");
        pass(&mut record, 20.0, 0.0);
        assert_eq!(record.first_above(tolerance_mm), None);
        // A pass that ends too early leaves stock on the wall, and so does one whose load was not believed.
        record.forget_from(15.0);
        assert_eq!(record.first_above(tolerance_mm), Some(15.0));
        assert!(record.last_above(tolerance_mm).unwrap() > 22.0);
        pass(&mut record, 19.8, 0.0);
        assert!(record.last_above(tolerance_mm).unwrap() > 22.0);
    }

    #[test]
    fn an_abandoned_shoulder_is_seen_but_not_known() {
        let mut record = record(40.0);
        for i in -20..=200 {
            record.sweep(f64::from(i) * 0.1, 2.0, true, true);
        }
        assert_eq!(record.depth_ahead_mm(19.5, 0.0, 0.5, false), 2.0);
        record.leave_shoulder(20.0, 3.5, false);
        assert_eq!(record.depth_ahead_mm(19.5, 0.0, 0.5, false), 3.5);
        assert_eq!(record.depth_ahead_mm(19.5, 0.0, 0.5, true), 2.0);
        record.leave_shoulder(20.0, 3.5, true);
        assert_eq!(record.depth_ahead_mm(19.5, 0.0, 0.5, true), 3.5);
        assert!(!record.at(21.0).known && record.first_above(2.5) == Some(20.0));
    }

    #[test]
    fn stock_after_a_shoulder_is_as_high_as_the_tip() {
        let mut record = record(40.0);
        for i in -20..=100 {
            record.sweep(f64::from(i) * 0.1, 2.0, true, true);
        }
        // Abandoned in the air of a gap; after it the tool has to climb.
        record.leave_shoulder(10.0, 2.0, false);
        record.lift(10.0, 2.0);
        for i in 90..=200 {
            record.sweep(f64::from(i) * 0.1, if i < 120 { 2.0 } else { 6.0 }, true, true);
        }
        assert_eq!((record.at(10.5).top_mm, record.at(15.0).top_mm), (2.0, 6.0));
        // The edge has cut as far as it leads before the climb.
        let from_mm = record.first_above(4.0).unwrap();
        assert!((12.0..13.5).contains(&from_mm), "{from_mm}");
    }

    #[test]
    fn a_shoulder_is_seen_when_the_edge_reaches_it() {
        let mut record = record(40.0);
        for i in -20..=400 {
            let along = f64::from(i) * 0.1;
            record.sweep(along, if along <= 20.0 { 1.0 } else { 4.0 }, true, true);
        }
        // The shoulder is parallel to the edge: 1 mm above the pass at 20, 4 mm from 21.7 on. With the tip at
        // the final size the whole edge meets it at once, 0.58 mm of lead before 20.
        let depth = |along: f64| record.depth_ahead_mm(along, 0.0, 0.5, true);
        assert_eq!(depth(10.0), 1.0);
        assert_eq!(depth(18.5), 1.0);
        assert_eq!(depth(19.2), 4.0);
        assert!((record.clear_place_mm(20.1, 1.0) - 20.1).abs() < 0.21);
        assert!((record.clear_place_mm(20.1, 0.0) - (20.1 - 1.0 / 3.0_f64.sqrt())).abs() < 0.21);
    }
}
