//! Colours on white: distinguishable in print, dark for slow.

use crate::limiting::Limiting;

/// Number of feed colours.
pub(crate) const FEED_TONES: usize = 12;
/// From slow to fast; lightness increases, so the picture is readable in greyscale.
const SLOW_TO_FAST: [[f64; 3]; 5] = [
    [13.0, 8.0, 135.0],
    [106.0, 0.0, 168.0],
    [177.0, 42.0, 144.0],
    [225.0, 100.0, 98.0],
    [252.0, 166.0, 54.0],
];
/// Hue of each axis, X to W, degrees.
const HUES: [f64; 9] = [355.0, 215.0, 275.0, 30.0, 185.0, 320.0, 60.0, 240.0, 95.0];

/// Colour of a feed step, 0 for the slowest.
pub(crate) fn feed_colour(tone: usize) -> String {
    let at = tone as f64 / (FEED_TONES - 1) as f64 * (SLOW_TO_FAST.len() - 1) as f64;
    let k = (at as usize).min(SLOW_TO_FAST.len() - 2);
    let mix = |channel: usize| {
        let (from, to) = (SLOW_TO_FAST[k][channel], SLOW_TO_FAST[k + 1][channel]);
        (from + (to - from) * (at - k as f64)).round().clamp(0.0, 255.0) as u8
    };
    format!("#{:02x}{:02x}{:02x}", mix(0), mix(1), mix(2))
}

/// Each axis has a hue; velocity is light, acceleration saturated, jerk dark.
pub(crate) fn cause_colour(cause: Limiting) -> String {
    match cause {
        Limiting::Feed => "#3fa34d".to_owned(),
        Limiting::ChordError => "#f0a500".to_owned(),
        Limiting::Joint => "#000000".to_owned(),
        Limiting::Standing => "#8a8a8a".to_owned(),
        Limiting::Nothing => "#d0d0d0".to_owned(),
        Limiting::Axis(axis, order) => {
            let (saturation, lightness) = [(0.75, 0.76), (0.80, 0.55), (0.85, 0.32)][order as usize];
            hsl(HUES[axis.index()], saturation, lightness)
        }
    }
}

fn hsl(hue: f64, saturation: f64, lightness: f64) -> String {
    let reach = saturation * lightness.min(1.0 - lightness);
    let channel = |n: f64| {
        let k = (n + hue / 30.0).rem_euclid(12.0);
        let value = lightness - reach * (k - 3.0).min(9.0 - k).clamp(-1.0, 1.0);
        (255.0 * value).round().clamp(0.0, 255.0) as u8
    };
    format!("#{:02x}{:02x}{:02x}", channel(0.0), channel(8.0), channel(4.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_cause_has_a_colour_of_its_own() {
        let mut colours: Vec<String> = (0..Limiting::COUNT)
            .map(|index| cause_colour(Limiting::of_index(index)))
            .collect();
        colours.sort();
        colours.dedup();
        assert_eq!(colours.len(), Limiting::COUNT);
    }

    #[test]
    fn hues_are_those_of_the_colour_circle() {
        assert_eq!(hsl(0.0, 1.0, 0.5), "#ff0000");
        assert_eq!(hsl(120.0, 1.0, 0.25), "#008000");
        assert_eq!(hsl(240.0, 1.0, 0.5), "#0000ff");
    }

    #[test]
    fn faster_is_lighter() {
        let light = |tone: usize| {
            let colour = feed_colour(tone);
            let channel = |at: usize| f64::from(u8::from_str_radix(&colour[at..at + 2], 16).unwrap());
            0.21 * channel(1) + 0.72 * channel(3) + 0.07 * channel(5)
        };
        assert!((1..FEED_TONES).all(|tone| light(tone) > light(tone - 1)));
    }
}
