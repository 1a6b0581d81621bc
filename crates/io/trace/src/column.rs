//! One quantity over many cycles: predicted from the previous values, with the residual in few bits.
//!
//! The next value of a motion is almost known: a position follows from velocity, acceleration and jerk. The
//! residual of the prediction is a few units in the last place, for any magnitude, and only the residual is
//! written. Nothing is rounded here: the reader repeats the prediction, from the same bits with the same IEEE
//! 754 operations in the same order, and adds the residual, as integers.
//!
//! Predictions: the polynomial through the last `n` values (orders 0 to 5), or the integral of the
//! derivatives, which have their own columns, read before, by the Euler-Maclaurin formula.

use crate::bits::{BitReader, BitWriter, folded, unfolded};

/// The last polynomial order.
pub(crate) const MAX_ORDER: u32 = 5;
/// The prediction by derivatives.
pub(crate) const BY_DERIVATIVES: u32 = 6;

/// The type of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// Integers, as `i64`.
    Whole,
    /// Doubles, as their bits.
    Double,
    /// Doubles that are singles, as the bits of the double.
    Single,
}

/// The columns of a quantity's first and second time derivative, and the time step.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Derivatives<'a> {
    pub(crate) first: &'a [u64],
    pub(crate) second: Option<&'a [u64]>,
    pub(crate) step_s: f64,
}

/// A packed column.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Packed {
    pub(crate) predictor: u32,
    /// Number of values with a written residual; the others are as predicted.
    pub(crate) coded: u32,
    pub(crate) rests: Vec<u8>,
}

/// A borrowed [`Packed`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct PackedRef<'a> {
    pub(crate) predictor: u32,
    pub(crate) coded: u32,
    pub(crate) rests: &'a [u8],
}

impl Packed {
    #[cfg(test)]
    fn borrowed(&self) -> PackedRef<'_> {
        PackedRef {
            predictor: self.predictor,
            coded: self.coded,
            rests: &self.rests,
        }
    }
}

/// Doubles as integers in the order of their values, so that neighbours differ by one. Its own inverse.
fn ordered(bits: u64) -> i64 {
    let bits = bits as i64;
    bits ^ ((bits >> 63) as u64 >> 1) as i64
}

/// Singles as integers in the order of their values.
fn ordered_single(bits: u32) -> i32 {
    let bits = bits as i32;
    bits ^ ((bits >> 31) as u32 >> 1) as i32
}

/// The polynomial of `order` through the last values, newest last, at the next step. If fewer values exist,
/// the order is reduced.
#[inline(always)]
fn polynomial(past: &[u64], order: u32) -> f64 {
    let n = past.len();
    let back = |steps: usize| f64::from_bits(past[n - steps]);
    match order.min(n as u32) {
        0 => 0.0,
        1 => back(1),
        2 => 2.0 * back(1) - back(2),
        3 => 3.0 * (back(1) - back(2)) + back(3),
        4 => 4.0 * (back(1) + back(3)) - 6.0 * back(2) - back(4),
        _ => 5.0 * (back(1) - back(4)) + 10.0 * (back(3) - back(2)) + back(5),
    }
}

#[inline(always)]
fn integral(past: &[u64], derivatives: &Derivatives<'_>) -> f64 {
    let n = past.len();
    if n == 0 {
        return 0.0;
    }
    let at = |column: &[u64], index: usize| f64::from_bits(column[index]);
    let h = derivatives.step_s;
    let (before, now) = (at(derivatives.first, n - 1), at(derivatives.first, n));
    let trapeze = f64::from_bits(past[n - 1]) + 0.5 * h * (before + now);
    match derivatives.second {
        None => trapeze,
        Some(second) => trapeze - h * h / 12.0 * (at(second, n) - at(second, n - 1)),
    }
}

/// The predicted next value, as an ordered integer. Inlined, so that constants are evaluated once per column.
#[inline(always)]
fn predicted(kind: Kind, predictor: u32, past: &[u64], derivatives: Option<&Derivatives<'_>>) -> i64 {
    match kind {
        Kind::Whole => match (predictor, past) {
            (0, _) | (_, []) => 0,
            (1, [.., last]) | (_, [last]) => *last as i64,
            (_, [.., before, last]) => (*last as i64).wrapping_mul(2).wrapping_sub(*before as i64),
        },
        Kind::Double | Kind::Single => {
            let value = match derivatives {
                Some(derivatives) if predictor == BY_DERIVATIVES => integral(past, derivatives),
                _ => polynomial(past, predictor),
            };
            // The bits of a NaN may differ between computers.
            let bits = if value.is_finite() {
                value.to_bits()
            } else {
                past.last().copied().unwrap_or(0)
            };
            as_integer(kind, bits)
        }
    }
}

#[inline]
fn as_integer(kind: Kind, value: u64) -> i64 {
    match kind {
        Kind::Whole => value as i64,
        Kind::Double => ordered(value),
        Kind::Single => i64::from(ordered_single((f64::from_bits(value) as f32).to_bits())),
    }
}

#[inline]
fn from_integer(kind: Kind, whole: i64) -> u64 {
    match kind {
        Kind::Whole => whole as u64,
        Kind::Double => ordered(whole as u64) as u64,
        // A written value fits; a damaged one is truncated.
        Kind::Single => f64::from(f32::from_bits(ordered_single(whole as u32) as u32)).to_bits(),
    }
}

/// Packs a column with the smallest encoding.
pub(crate) fn pack(kind: Kind, values: &[u64], derivatives: Option<&Derivatives<'_>>) -> Packed {
    let changes = values.windows(2).any(|pair| pair[0] != pair[1]);
    let orders = match (kind, changes) {
        (_, false) => 1..=1,
        (Kind::Whole, true) => 0..=2,
        (Kind::Double | Kind::Single, true) => 1..=MAX_ORDER,
    };
    let by_derivatives = (changes && derivatives.is_some()).then_some(BY_DERIVATIVES);
    let mut best = (u64::MAX, 1, Vec::new());
    let mut rests = Vec::with_capacity(values.len());
    for predictor in orders.chain(by_derivatives) {
        rests.clear();
        let mut bits = 0;
        for (n, &value) in values.iter().enumerate() {
            let predicted = predicted(kind, predictor, &values[..n], derivatives);
            let rest = folded(as_integer(kind, value).wrapping_sub(predicted));
            bits += u64::from(64 - rest.leading_zeros());
            rests.push(rest);
        }
        if bits < best.0 {
            best.0 = bits;
            best.1 = predictor;
            std::mem::swap(&mut best.2, &mut rests);
        }
    }
    let (_, predictor, rests) = best;
    let coded = rests
        .iter()
        .rposition(|&rest| rest != 0)
        .map_or(0, |last| last + 1);
    let mut writer = BitWriter::default();
    rests[..coded].iter().for_each(|&rest| writer.number(rest));
    Packed {
        predictor,
        coded: coded as u32,
        rests: writer.finish(),
    }
}

/// Unpacks a column of `count` values. `None` if it is invalid.
pub(crate) fn unpack(
    kind: Kind,
    packed: &PackedRef<'_>,
    count: usize,
    derivatives: Option<&Derivatives<'_>>,
    values: &mut Vec<u64>,
) -> Option<()> {
    values.clear();
    let most = match kind {
        Kind::Whole => 2,
        Kind::Double if derivatives.is_some() => BY_DERIVATIVES,
        Kind::Double | Kind::Single => MAX_ORDER,
    };
    let coded = packed.coded as usize;
    if packed.predictor > most || coded > count {
        return None;
    }
    let mut reader = BitReader::new(packed.rests);
    values.reserve(count);
    // One loop per predictor, without decisions inside.
    macro_rules! fill {
        ($kind:expr, $predictor:expr, $derivatives:expr) => {
            for n in 0..count {
                let rest = if n < coded {
                    unfolded(reader.number())
                } else {
                    0
                };
                let whole = predicted($kind, $predictor, values, $derivatives).wrapping_add(rest);
                values.push(from_integer($kind, whole));
            }
        };
    }
    match (kind, packed.predictor) {
        (Kind::Double, 1) => fill!(Kind::Double, 1, None),
        (Kind::Double, 2) => fill!(Kind::Double, 2, None),
        (Kind::Double, 3) => fill!(Kind::Double, 3, None),
        (Kind::Double, 4) => fill!(Kind::Double, 4, None),
        (Kind::Double, 5) => fill!(Kind::Double, 5, None),
        (Kind::Double, BY_DERIVATIVES) => fill!(Kind::Double, BY_DERIVATIVES, derivatives),
        (Kind::Single, 1) => fill!(Kind::Single, 1, None),
        (Kind::Single, predictor) => fill!(Kind::Single, predictor, None),
        (Kind::Whole, 1) => fill!(Kind::Whole, 1, None),
        (kind, predictor) => fill!(kind, predictor, derivatives),
    }
    reader.is_within().then_some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bits(values: &[f64]) -> Vec<u64> {
        values.iter().map(|value| value.to_bits()).collect()
    }

    fn back(
        kind: Kind,
        packed: &Packed,
        count: usize,
        derivatives: Option<&Derivatives<'_>>,
    ) -> Option<Vec<u64>> {
        let mut values = vec![7];
        unpack(kind, &packed.borrowed(), count, derivatives, &mut values).map(|()| values)
    }

    fn check(kind: Kind, values: &[u64], derivatives: Option<&Derivatives<'_>>) -> Packed {
        let packed = pack(kind, values, derivatives);
        assert_eq!(
            back(kind, &packed, values.len(), derivatives).as_deref(),
            Some(values),
            "{packed:?}"
        );
        packed
    }

    #[test]
    fn any_bits_come_back_as_they_were() {
        let state = 0x9E37_79B9_7F4A_7C15_u64;
        println!("seed {state:#x}");
        let mut random = evolvent_random::Random::from_state(state);
        let mut next = move || random.bits();
        let odd = [
            0,
            1 << 63,
            f64::NAN.to_bits(),
            0xFFF8_0000_0000_1234,
            f64::INFINITY.to_bits(),
            f64::NEG_INFINITY.to_bits(),
            f64::MAX.to_bits(),
            1,
            u64::MAX,
        ];
        for round in 0..500_u64 {
            let values: Vec<u64> = (0..next() % 60)
                .map(|_| match next() % 4 {
                    0 => odd[(next() % odd.len() as u64) as usize],
                    1 => (next() as i64 as f64 * 1e-17).to_bits(),
                    2 => round,
                    _ => next(),
                })
                .collect();
            let others: Vec<u64> = values.iter().map(|&value| value ^ next() >> 40).collect();
            let derivatives = Derivatives {
                first: &others,
                second: Some(&others),
                step_s: 1e-3,
            };
            check(Kind::Whole, &values, None);
            check(Kind::Double, &values, None);
            check(Kind::Double, &values, Some(&derivatives));
            let singles: Vec<u64> = values
                .iter()
                .map(|&bits| f64::from(f64::from_bits(bits) as f32).to_bits())
                .collect();
            check(Kind::Single, &singles, None);
        }
    }

    #[test]
    fn constant_column_takes_no_bytes_and_smooth_one_few() {
        let constant = bits(&[std::f64::consts::PI; 1000]);
        let packed = check(Kind::Double, &constant, None);
        assert!(packed.coded == 1 && packed.rests.len() < 13, "{packed:?}");
        // Exact quadratics in exact arithmetic: the third order leaves no residual.
        let quadratic: Vec<f64> = (0..1000).map(|n| f64::from(n * n) * 0.25).collect();
        let packed = check(Kind::Double, &bits(&quadratic), None);
        assert!(packed.coded <= 3, "{} coded", packed.coded);
    }

    #[test]
    fn damaged_columns_are_refused_or_read_without_panic() {
        let values: Vec<f64> = (0..300).map(|n| (f64::from(n) * 0.01).sin() * 100.0).collect();
        let packed = check(Kind::Double, &bits(&values), None);
        for cut in 0..packed.rests.len() {
            let mut short = packed.clone();
            short.rests.truncate(cut);
            assert_eq!(back(Kind::Double, &short, 300, None), None, "cut at {cut}");
        }
        for predictor in 0..9 {
            for coded in [0, 299, 301] {
                let odd = Packed {
                    predictor,
                    coded,
                    rests: packed.rests.clone(),
                };
                let _ = back(Kind::Double, &odd, 300, None);
                let _ = back(Kind::Whole, &odd, 300, None);
            }
        }
    }
}
