//! The diagrams contain every line and label, for any limits.

use evolvent_machine::{Machine, RateInput, figures_svg, figures_svg_of_axes};
use std::path::Path;

const PAPER: RateInput = RateInput {
    max_feed_mm_s: 100.0,
    acceleration_mm_s2: 981.0,
    jerk_mm_s3: 5000.0,
    increments_per_mm: 1000.0,
    permitted_error_increments: 1.0,
    min_radius_mm: 0.25,
};

/// The lines of the SVG that are text content.
fn texts(svg: &str) -> Vec<String> {
    let contents = svg.split("<text").skip(1).filter_map(|text| {
        let (_, after) = text.split_once('>')?;
        Some(after.split_once("</text>")?.0.trim().to_owned())
    });
    contents.collect()
}

#[test]
fn the_three_figures_have_their_lines_and_units() {
    let svg = figures_svg(&PAPER, "shop").unwrap();
    let texts = texts(&svg);
    let expected = [
        "shop",
        "radius R, mm",
        "feed F, mm/min",
        "by jerk",
        "by acceleration",
        "by maximum feed",
        "control rate f, Hz",
        "R 0.25",
        "0.5",
        "1",
        "2",
        "R 5 mm",
        "A 0.01 g",
        "A 0.1 g",
        "A 1 g",
        "A 10 g",
        "J 5 m/s\u{b3}",
        "J 50 m/s\u{b3}",
        "J 500 m/s\u{b3}",
        "J 5000 m/s\u{b3}",
        "permitted acceleration n, g",
        "k 1000",
        "k 10\u{a0}000",
        "k 100\u{a0}000",
    ];
    for text in expected {
        assert!(
            texts.iter().any(|found| found == text),
            "{text:?} is missing in {texts:?}"
        );
    }
    assert_eq!(texts.iter().filter(|text| text.starts_with("Figure ")).count(), 3);
    assert_eq!(
        svg.matches("<circle").count(),
        3,
        "the rational rate is marked in each figure"
    );
    assert!(
        texts.iter().any(|text| text.contains("297.3 Hz")),
        "the heading states the rate"
    );
}

#[test]
fn labels_do_not_overlap() {
    let svg = figures_svg(&PAPER, "shop").unwrap();
    let mut boxes: Vec<(f64, f64, f64, f64, String)> = Vec::new();
    for text in svg.split("<text").skip(1) {
        let attribute = |name: &str| {
            let (_, rest) = text.split_once(&format!(" {name}=\""))?;
            rest.split_once('"').map(|(value, _)| value.to_owned())
        };
        if attribute("transform").is_some() {
            continue;
        }
        let number = |name: &str| {
            attribute(name)
                .and_then(|value| value.parse::<f64>().ok())
                .unwrap()
        };
        let content = text
            .split_once('>')
            .unwrap()
            .1
            .split_once("</text>")
            .unwrap()
            .0
            .trim()
            .to_owned();
        let size = number("font-size");
        let width = 0.56 * size * content.chars().count() as f64;
        let left = number("x")
            - width
                * match attribute("text-anchor").as_deref() {
                    Some("end") => 1.0,
                    Some("middle") => 0.5,
                    _ => 0.0,
                };
        // plotters writes vertical alignment this way.
        let bottom = number("y")
            + size
                * match attribute("dy").as_deref() {
                    Some("0.76em") => 0.76,
                    Some("0.5ex") => 0.25,
                    _ => -0.25,
                };
        boxes.push((left, bottom - 0.7 * size, left + width, bottom, content));
    }
    assert!(boxes.len() > 40);
    for (i, a) in boxes.iter().enumerate() {
        assert!(a.0 >= 0.0 && a.2 <= 1000.0, "{} is outside the figure", a.4);
        for b in &boxes[i + 1..] {
            let apart = a.2 <= b.0 || b.2 <= a.0 || a.3 <= b.1 || b.3 <= a.1;
            assert!(apart, "{:?} and {:?} overlap", a.4, b.4);
        }
    }
}

#[test]
fn any_limits_with_a_rate_have_figures() {
    let inf = f64::INFINITY;
    let inputs = [
        RateInput {
            max_feed_mm_s: inf,
            ..PAPER
        },
        RateInput {
            acceleration_mm_s2: inf,
            ..PAPER
        },
        RateInput {
            jerk_mm_s3: inf,
            ..PAPER
        },
        RateInput {
            max_feed_mm_s: inf,
            jerk_mm_s3: inf,
            ..PAPER
        },
        RateInput {
            max_feed_mm_s: inf,
            acceleration_mm_s2: inf,
            ..PAPER
        },
        RateInput {
            acceleration_mm_s2: inf,
            jerk_mm_s3: inf,
            ..PAPER
        },
        RateInput {
            increments_per_mm: 1e-6,
            permitted_error_increments: 2e-6,
            min_radius_mm: 1e9,
            ..PAPER
        },
        RateInput {
            increments_per_mm: 1e9,
            min_radius_mm: 1e-9,
            ..PAPER
        },
        RateInput {
            increments_per_mm: 1.0,
            permitted_error_increments: 1e6,
            min_radius_mm: 6e5,
            ..PAPER
        },
        RateInput {
            max_feed_mm_s: 1e12,
            acceleration_mm_s2: 1e12,
            jerk_mm_s3: 1e12,
            ..PAPER
        },
        RateInput {
            max_feed_mm_s: 2e-9,
            acceleration_mm_s2: 2e-9,
            jerk_mm_s3: 2e-9,
            ..PAPER
        },
    ];
    for input in inputs {
        let svg = figures_svg(&input, "<&\"title\">").unwrap();
        assert!(
            svg.trim_end().ends_with("</svg>") && !svg.contains("NaN"),
            "{input:?}"
        );
        assert!(
            svg.contains("&lt;&amp;") && !svg.contains("<&"),
            "the title must be escaped"
        );
    }
    let nothing = RateInput {
        max_feed_mm_s: f64::NAN,
        ..PAPER
    };
    assert!(figures_svg(&nothing, "x").is_err());
    let machines = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines");
    let mill = Machine::load(&machines.join("mill-3axis.toml")).unwrap();
    assert!(
        figures_svg(&mill.rate_input(), &mill.name)
            .unwrap()
            .contains("mill-3axis")
    );
}

#[test]
fn figure_3_is_drawn_for_each_axis_by_its_own_limits() {
    // Mikron UCP 710: jerk is the active limit below 625 mm on X and below 3.7 mm on Z.
    let x = RateInput {
        max_feed_mm_s: 500.0,
        acceleration_mm_s2: 2500.0,
        jerk_mm_s3: 5000.0,
        ..PAPER
    };
    let z = RateInput {
        acceleration_mm_s2: 2100.0,
        jerk_mm_s3: 50_000.0,
        ..x
    };
    let both = RateInput {
        jerk_mm_s3: 50_000.0,
        ..x
    };
    let svg = figures_svg_of_axes(&both, &[('X', x), ('Z', z)], "ucp").unwrap();
    let texts = texts(&svg);
    let heads: Vec<_> = texts.iter().filter(|text| text.starts_with("Figure 3")).collect();
    assert_eq!(heads.len(), 2, "{heads:?}");
    assert!(
        heads[0].contains("limits of X") && heads[1].contains("limits of Z"),
        "{heads:?}"
    );
    // The line of X's jerk uses X alone: at 100 mm it permits 60 cbrt(5000 1e4) = 22 104 mm/min; Z permits 47
    // 622.
    let alone = figures_svg_of_axes(&x, &[('X', x)], "ucp").unwrap();
    // Height of the line over radius in the first figure, independent of the numbering of lines.
    let lines = |svg: &str| -> Vec<String> {
        let second = svg.match_indices("Figure ").nth(1).unwrap().0;
        let polylines = svg[..second].split("<polyline").skip(1);
        polylines
            .map(|line| line.split_once("/>").unwrap().0.to_owned())
            .collect()
    };
    assert!(lines(&svg).len() > 3);
    assert_eq!(lines(&svg), lines(&alone));
    assert_ne!(lines(&svg), lines(&figures_svg(&both, "ucp").unwrap()));
}
