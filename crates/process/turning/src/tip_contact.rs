//! Decides whether the measured load comes from stock under the tip, or only from stock farther up the edge.

/// Relative change of the depth that may be noise.
const LEVEL: f64 = 0.2;
/// Rise or fall of the stock that still counts as level, as a fraction of the slope of the edge. At a wall
/// square to the feed the depth changes with the slope itself.
const TAPER: f64 = 0.25;
/// Factor of noise on a depth that is compared with the record.
const NOISE: f64 = 1.15;

/// Distance by which contact may be felt late, mm.
const LATE_MM: f64 = 0.5;
/// Relative increase of a depth in a hard spot.
const HARD: f64 = 0.35;

/// Decides from the load whether there is stock under the tip.
///
/// The outer end of the edge leads. It cuts a ridge after a groove while the tip is still in the groove. If
/// the ridge is narrower than the overhang of the edge, its load is as steady as that of a cut over the whole
/// depth. Stock that was expected is not such a ridge, and neither is stock as high as the record's maximum.
/// Other stock may be a ridge, after a gap or where the depth has changed. But the edge passes a ridge:
/// within a distance of its overhang plus the width of the ridge, the load changes. A load that is steady for
/// longer belongs to stock under the tip.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TipContact {
    front: Front,
    level: Option<Level>,
}

/// Where stock is expected. Positions of the tip in mm along the cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Front {
    /// A face square to the feed, which the outer end of the edge meets first.
    Face(f64),
    /// A shoulder along the edge, all of which meets it at once.
    Shoulder(f64),
    /// At an unknown position.
    Unknown,
}

/// A steady depth.
#[derive(Clone, Copy, Debug)]
struct Level {
    depth_mm: f64,
    /// Position of the tip when the depth was taken, mm along the cut.
    position_mm: f64,
    /// Position of the tip at which the edge began to cut the stock of this depth, mm.
    from_mm: f64,
    /// Position from which the tip has cut over a whole revolution in stock, if it has, mm.
    since_mm: f64,
    /// Position up to which the tip is in stock, mm along the cut, while the depth is constant or falls.
    stock_to_mm: f64,
}

/// One cycle of a cut, mm.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TipCut {
    /// Position of the tip.
    pub(crate) position_mm: f64,
    /// Position up to which it has cut over a whole revolution: its position a revolution ago.
    pub(crate) swept_mm: f64,
    /// Position at which the cut was first felt.
    pub(crate) contact_mm: f64,
    /// Mean depth of a revolution.
    pub(crate) depth_mm: f64,
    /// Maximum height of stock under the edge above the tip, by the record.
    pub(crate) bound_mm: f64,
}

/// What is under the tip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum UnderTip {
    /// Stock or air.
    Unknown,
    /// Stock.
    Stock,
    /// Stock, since the tip was at a position, mm along the cut.
    StockSince(f64),
}

impl Front {
    /// Whether a contact that led to a depth, both in mm, was with the expected stock.
    fn is_met(self, contact_mm: f64, depth_mm: f64, slope: f64) -> bool {
        match self {
            Self::Face(at) => contact_mm + (1.0 - HARD) * depth_mm / slope <= at + LATE_MM,
            Self::Shoulder(at) => contact_mm <= at + 2.0 * LATE_MM,
            Self::Unknown => false,
        }
    }
}

impl TipContact {
    /// Nothing is cut, and stock is expected at an unknown position.
    pub(crate) const NONE: Self = Self {
        front: Front::Unknown,
        level: None,
    };

    /// The cut has ended.
    pub(crate) fn lose(&mut self) {
        *self = Self::NONE;
    }

    /// Sets where the next contact is expected.
    pub(crate) fn set_front(&mut self, front: Front) {
        self.front = front;
    }

    /// The front that remains at a position, mm, of a cut that began at a contact and has a depth.
    pub(crate) fn front_left(
        &self,
        position_mm: f64,
        contact_mm: Option<f64>,
        depth_mm: f64,
        slope: f64,
    ) -> Front {
        let is_stock = match (self.level, contact_mm) {
            (Some(level), _) => level.position_mm <= level.stock_to_mm,
            (None, Some(contact)) => self.front.is_met(contact, depth_mm, slope),
            (None, None) => return self.front,
        };
        if is_stock {
            Front::Shoulder(position_mm)
        } else {
            Front::Unknown
        }
    }

    /// Follows a cut of an edge with a slope and an overhang (mm). Real-time safe.
    pub(crate) fn follow(&mut self, cut: TipCut, slope: f64, overhang_mm: f64) -> UnderTip {
        let front = self.front;
        let level = self.level.get_or_insert_with(|| Level {
            depth_mm: cut.depth_mm,
            position_mm: cut.position_mm,
            from_mm: cut.contact_mm,
            since_mm: cut.swept_mm,
            stock_to_mm: if front.is_met(cut.contact_mm, cut.depth_mm, slope) {
                f64::INFINITY
            } else {
                f64::NEG_INFINITY
            },
        });
        let max = TAPER * slope * (cut.position_mm - level.position_mm).max(0.0);
        level.depth_mm += (cut.depth_mm - level.depth_mm).clamp(-max, max);
        level.position_mm = cut.position_mm;
        if (cut.depth_mm - level.depth_mm).abs() > LEVEL * level.depth_mm {
            level.change(&cut, slope);
        }
        if cut.position_mm <= level.stock_to_mm {
            return UnderTip::Stock;
        }
        // The first point of a ridge is at most the overhang before the tip, and its width follows from the
        // depth.
        if cut.position_mm > level.from_mm + overhang_mm + level.depth_mm / slope {
            level.stock_to_mm = f64::INFINITY;
            return UnderTip::StockSince(level.since_mm);
        }
        if cut.bound_mm <= NOISE * cut.depth_mm {
            UnderTip::Stock
        } else {
            UnderTip::Unknown
        }
    }
}

impl Level {
    /// Handles a depth that has changed by more than noise and a taper.
    fn change(&mut self, cut: &TipCut, slope: f64) {
        // The end of a change counts as noise.
        let rest_mm = LEVEL * cut.depth_mm / slope;
        // The depth falls while the tip removes more than enters at the outer end. While it rises, the tip
        // may be in air.
        let falls = cut.depth_mm < self.depth_mm && cut.position_mm <= self.stock_to_mm;
        *self = Self {
            depth_mm: cut.depth_mm,
            position_mm: cut.position_mm,
            from_mm: cut.position_mm,
            since_mm: cut.position_mm + rest_mm,
            stock_to_mm: if falls {
                cut.position_mm + 2.0 * rest_mm
            } else {
                f64::NEG_INFINITY
            },
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SLOPE: f64 = 1.75;
    const OVERHANG_MM: f64 = 6.0;

    /// The depth of an edge with its tip at a position over sections of stock (from, to, height).
    fn depth_mm(stock: &[(f64, f64, f64)], position_mm: f64) -> f64 {
        let under = |&(from, to, height): &(f64, f64, f64)| {
            let lead = |at: f64| (at - position_mm).max(0.0) * SLOPE;
            (lead(to).min(height) - lead(from)).max(0.0)
        };
        stock.iter().map(under).sum()
    }

    /// Positions at which stock certainly remains, in steps of 0.1 mm.
    fn sure(stock: &[(f64, f64, f64)], front: Front) -> Vec<f64> {
        let mut tip = TipContact::NONE;
        tip.set_front(front);
        let mut contact = None;
        let mut sure: Vec<f64> = Vec::new();
        for k in 0..400 {
            let position_mm = 0.1 * f64::from(k) - 8.0;
            let depth_mm = depth_mm(stock, position_mm);
            if depth_mm < 0.1 {
                if contact.take().is_some() {
                    tip.lose();
                }
                continue;
            }
            let cut = TipCut {
                position_mm,
                swept_mm: position_mm,
                contact_mm: *contact.get_or_insert(position_mm),
                depth_mm,
                bound_mm: f64::INFINITY,
            };
            match tip.follow(cut, SLOPE, OVERHANG_MM) {
                UnderTip::Unknown => {}
                UnderTip::Stock => sure.push(position_mm),
                UnderTip::StockSince(from) => {
                    let before = (0..k).map(|k| 0.1 * f64::from(k) - 8.0);
                    sure.extend(before.filter(|place| *place >= from));
                    sure.push(position_mm);
                }
            }
        }
        sure
    }

    #[test]
    fn a_ridge_up_the_edge_is_no_stock_under_the_tip() {
        for width in [0.5, 1.2, 2.0, 3.0] {
            for (height, front) in [6.0, 9.0, 10.4]
                .into_iter()
                .flat_map(|height| [(height, Front::Unknown), (height, Front::Face(0.0))])
            {
                let of = |stock: &[_]| sure(stock, front);
                let end = 10.0 + width;
                let ridge = of(&[(10.0, end, height)]);
                assert!(
                    ridge.iter().all(|at| (10.0..=end).contains(at)),
                    "{width} {height}: {ridge:?}"
                );
                // A step down after it.
                let step = of(&[(10.0, end, height), (end, 99.0, 0.5 * SLOPE * width)]);
                assert!(step.iter().all(|at| *at >= 10.0), "{width} {height}: {step:?}");
                assert!(step.iter().any(|at| *at > end), "{width} {height}");
            }
        }
    }

    #[test]
    fn a_groove_that_the_edge_bridges_is_not_stock() {
        let found = sure(&[(0.0, 15.0, 5.0), (17.0, 99.0, 5.0)], Front::Face(0.0));
        assert!(found.iter().all(|at| !(15.2..=17.0).contains(at)), "{found:?}");
        assert!(found.iter().any(|at| *at < 1.0) && found.iter().any(|at| *at > 20.0));
    }

    #[test]
    fn stock_is_known_from_where_it_was_level() {
        for height in [1.0, 3.0, 5.0] {
            let found = sure(&[(0.0, 99.0, height)], Front::Unknown);
            assert!(found[0] < 0.5 && found.len() > 300, "{height}: {found:?}");
        }
        // As high as the record permits: at once.
        let mut tip = TipContact::NONE;
        let cut = TipCut {
            position_mm: 1.0,
            swept_mm: 0.5,
            contact_mm: 0.0,
            depth_mm: 2.0,
            bound_mm: 2.1,
        };
        assert_eq!(tip.follow(cut, SLOPE, OVERHANG_MM), UnderTip::Stock);
        assert_eq!(
            tip.follow(TipCut { bound_mm: 9.0, ..cut }, SLOPE, OVERHANG_MM),
            UnderTip::Unknown
        );
    }
}
