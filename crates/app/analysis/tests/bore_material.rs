//! Runs the text of programs from [`BoreProgram`] on a grid of material: rapids and plunges of finishing must
//! not meet any.
#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use evolvent_analysis::{BoreError, BoreFinishing, BoreProgram, BoreRequest, BoreRoughing};
use evolvent_path::{HoleStart, Milling};
use evolvent_random::{Random, cases};

/// Cells across the hole.
const CELLS: usize = 81;

/// The height of the material over a grid of cells, and the tool above it.
struct Stock {
    cell_mm: f64,
    heights_mm: Vec<f64>,
    tool_mm: f64,
    at: [f64; 3],
}

impl Stock {
    fn new(request: &BoreRequest) -> Self {
        Self {
            cell_mm: request.hole_mm / CELLS as f64,
            heights_mm: vec![request.top_mm; CELLS * CELLS],
            tool_mm: request.tool_mm,
            at: [0.0, 0.0, f64::INFINITY],
        }
    }

    /// Cells whose material the tool meets here; a rim of `rim_mm` of the tool does not count.
    fn met(&self, [x, y, z]: [f64; 3], rim_mm: f64) -> Vec<usize> {
        let reach = 0.5 * self.tool_mm - rim_mm;
        let centre = |index: usize| (index as f64 - 0.5 * (CELLS - 1) as f64) * self.cell_mm;
        let near = |middle: f64| {
            let index =
                |value: f64| (value / self.cell_mm + 0.5 * CELLS as f64).clamp(0.0, CELLS as f64 - 1.0);
            index(middle - reach) as usize..=index(middle + reach) as usize
        };
        let mut met = Vec::new();
        for row in near(y) {
            for column in near(x) {
                let cell = row * CELLS + column;
                if reach > 0.0
                    && f64::hypot(centre(column) - x, centre(row) - y) <= reach
                    && self.heights_mm[cell] > z + 1e-9
                {
                    met.push(cell);
                }
            }
        }
        met
    }

    fn cut(&mut self, at: [f64; 3]) {
        for cell in self.met(at, 0.0) {
            self.heights_mm[cell] = at[2];
        }
        self.at = at;
    }

    /// Moves straight; returns whether the tool met material. Sampled paths leave cusps, so a rim does not
    /// count.
    fn straight(&mut self, to: [f64; 3]) -> bool {
        let from = self.at;
        let long = f64::hypot(to[0] - from[0], to[1] - from[1]);
        let steps = 1 + (long / self.cell_mm) as usize;
        let mut has_met = false;
        for step in 0..=steps {
            let share = step as f64 / steps as f64;
            let at = std::array::from_fn(|axis| {
                if to[axis] == from[axis] {
                    to[axis]
                } else {
                    from[axis] + share * (to[axis] - from[axis])
                }
            });
            has_met |= !self.met(at, 0.02 * self.tool_mm).is_empty();
            self.cut(at);
        }
        has_met
    }

    /// Cuts along a circle or an involute about `centre`; `base_mm` is the radius of the involute's base
    /// circle.
    fn curve(&mut self, to: [f64; 2], centre: [f64; 2], base_mm: Option<f64>, is_left: bool) {
        let z = self.at[2];
        let turn = if is_left { 1.0 } else { -1.0 };
        let from = [self.at[0] - centre[0], self.at[1] - centre[1]];
        let end = [to[0] - centre[0], to[1] - centre[1]];
        // Fine enough for cusps far below the rim.
        let step_mm = (0.05 * self.tool_mm).min(0.5 * self.cell_mm);
        if let Some(r) = base_mm {
            let roll = |[x, y]: [f64; 2]| ((x * x + y * y) / (r * r) - 1.0).max(0.0).sqrt();
            let (first, last) = (roll(from), roll(end));
            // An involute that unrolls to the left and runs inwards equals one that unrolls to the right and
            // runs outwards.
            let hand = if last > first { turn } else { -turn };
            let turned = from[1].atan2(from[0]) - hand * (first - first.atan());
            let count = 1 + (0.5 * r * (last * last - first * first).abs() / step_mm) as usize;
            for index in 0..=count {
                let square = first * first + (last * last - first * first) * index as f64 / count as f64;
                let phi = square.max(0.0).sqrt();
                let (distance, angle) = (r * (1.0 + square).sqrt(), turned + hand * (phi - phi.atan()));
                self.cut([
                    centre[0] + distance * angle.cos(),
                    centre[1] + distance * angle.sin(),
                    z,
                ]);
            }
        } else {
            let radius = f64::hypot(from[0], from[1]);
            let begin = from[1].atan2(from[0]);
            let count = 1 + (std::f64::consts::TAU * radius / step_mm) as usize;
            for index in 0..=count {
                let angle = begin + turn * std::f64::consts::TAU * index as f64 / count as f64;
                self.cut([
                    centre[0] + radius * angle.cos(),
                    centre[1] + radius * angle.sin(),
                    z,
                ]);
            }
        }
        let reached = f64::hypot(self.at[0] - to[0], self.at[1] - to[1]);
        assert!(
            reached < 1e-6 * (1.0 + self.cell_mm * CELLS as f64),
            "{reached} mm beside the end"
        );
        self.at = [to[0], to[1], z];
    }

    /// Runs a program; returns the lines of rapids and of plunges in finishing that met material.
    fn run(&mut self, text: &str) -> Vec<String> {
        let mut met = Vec::new();
        let mut is_finishing = false;
        for line in text.lines() {
            if let Some(comment) = line.strip_prefix('(') {
                is_finishing |= comment.starts_with("finishing at");
                continue;
            }
            let words: Vec<(char, f64)> = line
                .split_whitespace()
                .map(|word| (word.chars().next().unwrap(), word[1..].parse().unwrap()))
                .collect();
            let get = |letter| words.iter().find(|word| word.0 == letter).map(|word| word.1);
            let to = std::array::from_fn(|axis| get(['X', 'Y', 'Z'][axis]).unwrap_or(self.at[axis]));
            let code = get('G');
            match (get('I'), get('J')) {
                (Some(i), Some(j)) => {
                    let centre = [self.at[0] + i, self.at[1] + j];
                    self.curve([to[0], to[1]], centre, get('R'), code.unwrap() >= 3.0);
                }
                _ if code == Some(0.0) || code == Some(1.0) => {
                    if self.at[2].is_infinite() {
                        self.at[2] = to[2];
                    }
                    let has_met = self.straight(to);
                    if has_met && (code == Some(0.0) || is_finishing) {
                        met.push(line.to_owned());
                    }
                }
                _ => {}
            }
        }
        met
    }
}

fn random_request(random: &mut Random) -> BoreRequest {
    let hole_mm = random.log(4.0, 200.0);
    let tool_mm = hole_mm * random.between(0.08, 0.85);
    let room = 0.5 * (hole_mm - tool_mm);
    let inside = |random: &mut Random| {
        let (distance, angle) = (room * random.between(0.0, 0.99), random.between(0.0, 6.3));
        HoleStart::Point([distance * angle.cos(), distance * angle.sin()])
    };
    let turns = 1 + random.below(3) as u32;
    let allowance_mm = room * random.between(0.0, 0.95);
    let depth_mm = hole_mm * random.between(0.1, 1.0);
    let start = match random.below(5) {
        0 => None,
        1 => Some(HoleStart::CurvatureRadius(room * random.between(0.0, 0.99))),
        2 => Some(HoleStart::Length(room * random.between(0.2, 3.0))),
        _ => Some(inside(random)),
    };
    BoreRequest {
        hole_mm,
        tool_mm,
        milling: *random.one_of(&[Milling::Climb, Milling::Conventional]),
        centre_mm: [0.0, 0.0],
        top_mm: 0.0,
        depth_mm,
        step_mm: random.one_of(&[None, Some(0.4 * depth_mm)]).to_owned(),
        safe_mm: 5.0,
        roughing: Some(BoreRoughing {
            pitch_mm: tool_mm * random.between(0.2, 0.95),
            turns: None,
            allowance_mm: allowance_mm.min(tool_mm * random.between(0.5, 1.01)),
            start: if random.below(2) == 0 {
                HoleStart::Centre
            } else {
                inside(random)
            },
        }),
        finishing: Some(BoreFinishing { turns, start }),
        feed_mm_min: 1000.0,
        finish_feed_mm_min: None,
        plunge_feed_mm_min: 200.0,
        spindle_rpm: 3000.0,
        tool_number: None,
        tolerance_mm: None,
    }
}

/// Cells of material that remain when roughing from the centre is done and the tool moves down `distance_mm`
/// from it.
fn met_after_roughing(request: &BoreRequest, distance_mm: f64) -> usize {
    let alone = BoreRequest {
        finishing: None,
        step_mm: None,
        ..request.clone()
    };
    let mut stock = Stock::new(&alone);
    assert_eq!(
        stock.run(&BoreProgram::new(alone).unwrap().text()),
        Vec::<String>::new()
    );
    stock.met([distance_mm, 0.0, -request.depth_mm], 0.0).len()
}

#[test]
fn finishing_moves_down_only_where_roughing_has_cut() {
    let mut random = Random::seeded(0xB0_4E);
    let (mut written, mut refused, mut shown) = (0, 0, 0);
    for _ in 0..cases(150) {
        let request = random_request(&mut random);
        match BoreProgram::new(request.clone()) {
            Ok(program) => {
                let met = Stock::new(&request).run(&program.text());
                assert!(met.is_empty(), "{request:?}: {met:?}\n{}", program.text());
                written += 1;
            }
            Err(BoreError::FinishStart {
                distance_mm,
                cleared_mm,
                ..
            }) => {
                refused += 1;
                // A start that is rejected by a wide margin would have met material.
                let cell_mm = request.hole_mm / CELLS as f64;
                let is_central = request
                    .roughing
                    .is_some_and(|roughing| roughing.start == HoleStart::Centre);
                if is_central && distance_mm > cleared_mm[1] + 2.0 * cell_mm {
                    assert!(met_after_roughing(&request, distance_mm) > 0, "{request:?}");
                    shown += 1;
                }
            }
            Err(error) => {
                let text = error.to_string();
                let known = ["ring", "inside it", "an involute of", "rough-turns"];
                assert!(
                    known.iter().any(|part| text.contains(part)),
                    "{request:?}: {text}"
                );
            }
        }
    }
    assert!(
        evolvent_random::cases_are_given() || (written > 50 && refused > 10 && shown > 3),
        "{written} {refused} {shown}"
    );
}

#[test]
fn bad_finishing_moves_are_refused_with_a_remedy() {
    let mut request = random_request(&mut Random::from_state(1));
    (request.hole_mm, request.tool_mm) = (100.0, 10.0);
    let with = |allowance_mm: f64, start: [f64; 2], rough: HoleStart| {
        let mut request = request.clone();
        request.roughing = Some(BoreRoughing {
            pitch_mm: 2.0,
            turns: None,
            allowance_mm,
            start: rough,
        });
        request.finishing = Some(BoreFinishing {
            turns: 1,
            start: Some(HoleStart::Point(start)),
        });
        BoreProgram::new(request)
            .map(|_| ())
            .map_err(|error| error.to_string())
    };
    let ring = with(12.0, [0.0, 0.0], HoleStart::Centre).unwrap_err();
    assert!(
        ring.contains("allowance 12") && ring.contains("a ring of 2.000 mm") && ring.contains("at most 10"),
        "{ring}"
    );
    assert_eq!(with(10.0, [0.0, 0.0], HoleStart::Centre), Ok(()));
    let far = with(8.0, [40.0, 0.0], HoleStart::Centre).unwrap_err();
    assert!(
        far.contains("40.000 mm")
            && far.contains("from 0.000 to 37.000 mm")
            && far.contains("smaller --allowance"),
        "{far}"
    );
    assert_eq!(with(8.0, [37.0, 0.0], HoleStart::Centre), Ok(()));
    let core = with(1.0, [0.0, 0.0], HoleStart::Point([20.0, 0.0])).unwrap_err();
    assert!(
        core.contains("0.000 mm from the hole's centre") && core.contains("--finish-only"),
        "{core}"
    );
    // The tool has been at the start of roughing.
    assert_eq!(with(1.0, [20.0, 0.0], HoleStart::Point([20.0, 0.0])), Ok(()));
}

#[test]
fn a_circle_below_the_least_radius_is_refused() {
    let mut request = random_request(&mut Random::from_state(1));
    (request.hole_mm, request.tool_mm, request.finishing) = (20.001, 20.0, None);
    let with = |hole_mm: f64, allowance_mm: f64| {
        let mut request = request.clone();
        request.hole_mm = hole_mm;
        let start = HoleStart::Centre;
        request.roughing = Some(BoreRoughing {
            pitch_mm: 1.0,
            turns: None,
            allowance_mm,
            start,
        });
        BoreProgram::new(request)
            .map(|_| ())
            .map_err(|error| error.to_string())
    };
    let tool = with(20.001, 0.0).unwrap_err();
    assert!(
        tool.contains("a circle of 0.000500 mm") && tool.contains("at least 0.00127 mm"),
        "{tool}"
    );
    assert_eq!(with(20.0026, 0.0), Ok(()));
    let allowance = with(21.0, 0.4995).unwrap_err();
    assert!(allowance.contains("smaller --allowance"), "{allowance}");
}

#[test]
fn coordinates_have_no_noise_of_rounding() {
    let mut request = random_request(&mut Random::from_state(1));
    (request.hole_mm, request.tool_mm, request.centre_mm) = (60.0, 20.0, [0.1, 0.2]);
    request.roughing = Some(BoreRoughing {
        pitch_mm: 4.0,
        turns: None,
        allowance_mm: 0.3,
        start: HoleStart::Centre,
    });
    request.finishing = Some(BoreFinishing {
        turns: 2,
        start: None,
    });
    let text = BoreProgram::new(request).unwrap().text();
    for word in text
        .lines()
        .filter(|line| line.starts_with('G'))
        .flat_map(str::split_whitespace)
    {
        let digits = word.split_once('.').map_or(0, |(_, decimals)| decimals.len());
        let value: f64 = word[1..].parse().unwrap();
        // More than nine decimals are used only if nine would be another number.
        let short = (value * 1e9).round() * 1e-9;
        let is_given = word.starts_with(['R', 'F']);
        assert!(digits <= 9 || is_given || (value - short).abs() > 1e-12, "{word}");
        assert_ne!(&word[1..], "-0");
    }
}
