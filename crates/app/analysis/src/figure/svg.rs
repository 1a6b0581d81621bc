//! A compact SVG writer with the elements that a picture of a plan needs.

use std::fmt::Write as _;

/// Anchor of a text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Anchor {
    Start,
    Middle,
    End,
}

/// A picture under construction.
#[derive(Debug)]
pub(crate) struct Svg {
    body: String,
    width: f64,
}

impl Svg {
    pub(crate) fn new(width: f64) -> Self {
        Self {
            body: String::with_capacity(1 << 18),
            width,
        }
    }

    /// The complete file; the height is known only after drawing.
    pub(crate) fn finish(self, height: f64, style: &str) -> String {
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w:.0}\" height=\"{height:.0}\" viewBox=\"0 \
             0 {w:.0} {height:.0}\">\n<style>{style}</style>\n\
             <rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n{}</svg>\n",
            self.body,
            w = self.width
        )
    }

    pub(crate) fn text(&mut self, at: (f64, f64), anchor: Anchor, class: &str, text: &str) {
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        self.push(format_args!(
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"{anchor}\" class=\"{class}\">{}</text>\n",
            at.0,
            at.1,
            escaped(text)
        ));
    }

    pub(crate) fn line(&mut self, from: (f64, f64), to: (f64, f64), class: &str) {
        self.push(format_args!(
            "<line x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\" class=\"{class}\"/>\n",
            from.0, from.1, to.0, to.1
        ));
    }

    /// A rectangle of any fill.
    pub(crate) fn rect(&mut self, at: (f64, f64), size: (f64, f64), fill: &str) {
        self.push(format_args!(
            "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"{fill}\"/>\n",
            at.0, at.1, size.0, size.1
        ));
    }

    pub(crate) fn frame(&mut self, at: (f64, f64), size: (f64, f64)) {
        self.push(format_args!(
            "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" class=\"frame\"/>\n",
            at.0, at.1, size.0, size.1
        ));
    }

    pub(crate) fn circle(&mut self, at: (f64, f64), radius: f64, class: &str) {
        self.push(format_args!(
            "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"{radius:.1}\" class=\"{class}\"/>\n",
            at.0, at.1
        ));
    }

    /// Draws a line along `pen`; an empty pen draws nothing.
    pub(crate) fn stroke(&mut self, pen: &Pen, colour: &str, width: f64, more: &str) {
        if !pen.data.is_empty() {
            self.push(format_args!(
                "<path d=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width}\" \
                 stroke-linejoin=\"round\" {more}/>\n",
                pen.data
            ));
        }
    }

    /// Fills the area within `pen`.
    pub(crate) fn fill(&mut self, pen: &Pen, colour: &str) {
        if !pen.data.is_empty() {
            // A thin outline keeps areas visible that are narrower than a pixel.
            self.push(format_args!(
                "<path d=\"{}\" fill=\"{colour}\" stroke=\"{colour}\" stroke-width=\".7\"/>\n",
                pen.data
            ));
        }
    }

    fn push(&mut self, text: std::fmt::Arguments<'_>) {
        // Writing to a string cannot fail.
        let _written = self.body.write_fmt(text);
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

/// Relative path data in tenths of a pixel: a third of the bytes of absolute decimals.
#[derive(Debug, Default)]
pub(crate) struct Pen {
    data: String,
    last: (i64, i64),
}

impl Pen {
    pub(crate) fn move_to(&mut self, x: f64, y: f64) {
        self.last = (tenths(x), tenths(y));
        self.data.push('M');
        number(&mut self.data, self.last.0, false);
        number(&mut self.data, self.last.1, true);
    }

    pub(crate) fn line_to(&mut self, x: f64, y: f64) {
        let to = (tenths(x), tenths(y));
        let by = (to.0 - self.last.0, to.1 - self.last.1);
        match by {
            (0, 0) => return,
            (dx, 0) => {
                self.data.push('h');
                number(&mut self.data, dx, false);
            }
            (0, dy) => {
                self.data.push('v');
                number(&mut self.data, dy, false);
            }
            (dx, dy) => {
                self.data.push('l');
                number(&mut self.data, dx, false);
                number(&mut self.data, dy, true);
            }
        }
        self.last = to;
    }

    pub(crate) fn close(&mut self) {
        self.data.push('z');
    }
}

fn tenths(value: f64) -> i64 {
    // A NaN is drawn in the corner.
    (10.0 * value).round().clamp(-1e7, 1e7) as i64
}

fn number(data: &mut String, tenths: i64, separate: bool) {
    if tenths < 0 {
        data.push('-');
    } else if separate {
        data.push(' ');
    }
    let (whole, rest) = (tenths.unsigned_abs() / 10, tenths.unsigned_abs() % 10);
    let _written = match (whole, rest) {
        (0, 0) => write!(data, "0"),
        (whole, 0) => write!(data, "{whole}"),
        (0, rest) => write!(data, ".{rest}"),
        (whole, rest) => write!(data, "{whole}.{rest}"),
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn path_data_add_up_to_the_places_drawn() {
        let mut pen = Pen::default();
        pen.move_to(1.0, -2.04);
        pen.line_to(1.0, 3.26);
        pen.line_to(1.01, 3.26);
        pen.line_to(-0.5, 3.3);
        pen.line_to(0.0, 4.0);
        pen.close();
        assert_eq!(pen.data, "M1-2v5.3h-1.5l.5 .7z");
    }

    #[test]
    fn texts_cannot_end_the_picture() {
        let mut svg = Svg::new(10.0);
        svg.text((0.0, 0.0), Anchor::Start, "t", "</svg>&");
        let file = svg.finish(5.0, "");
        assert!(file.contains("&lt;/svg&gt;&amp;") && file.matches("</svg>").count() == 1);
    }
}
