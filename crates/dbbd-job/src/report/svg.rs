//! A small SVG builder; the colours are classes of `plot.css`.

use std::fmt::Write as _;

use dbbd_model::base::text::escape_controls;

const PLOT_CSS: &str = include_str!("plot.css");

/// The part of a text that is at its point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    Start,
    Middle,
    End,
}

impl Anchor {
    fn word(self) -> &'static str {
        match self {
            Self::Start => "start",
            Self::Middle => "middle",
            Self::End => "end",
        }
    }
}

/// An SVG under construction, in pixels with y downwards. An element with a coordinate that is not finite is left out.
#[derive(Clone, Debug)]
pub struct Svg {
    text: String,
}

impl Svg {
    /// Begins a picture; a screen reader reads `title` and `description`.
    pub fn new(width: f64, height: f64, title: &str, description: &str) -> Self {
        let title = escape(title);
        let (w, h) = (px(width), px(height));
        let mut text = format!("<svg class=\"plot\" viewBox=\"0 0 {w} {h}\" role=\"img\" ");
        let _ = write!(text, "aria-label=\"{title}. {}\"><title>{title}</title>", escape(description));
        Self { text }
    }

    pub fn finish(mut self) -> String {
        self.text.push_str("</svg>");
        self.text
    }

    pub fn line(&mut self, class: &str, from: [f64; 2], to: [f64; 2]) {
        if finite(&from) && finite(&to) {
            let [x1, y1, x2, y2] = [from[0], from[1], to[0], to[1]].map(px);
            let _ = write!(
                self.text,
                "<line class=\"{class}\" x1=\"{x1}\" y1=\"{y1}\" x2=\"{x2}\" y2=\"{y2}\"/>"
            );
        }
    }

    /// A rectangle between two corners; `tip` is its tooltip, if not empty.
    pub fn rect(&mut self, class: &str, a: [f64; 2], b: [f64; 2], tip: &str) {
        if finite(&a) && finite(&b) {
            let [x, y] = [a[0].min(b[0]), a[1].min(b[1])].map(px);
            let [w, h] = [(a[0] - b[0]).abs(), (a[1] - b[1]).abs()].map(px);
            let _ =
                write!(self.text, "<rect class=\"{class}\" x=\"{x}\" y=\"{y}\" width=\"{w}\" height=\"{h}\"");
            self.tip("rect", tip);
        }
    }

    /// A rectangle of colour `#rrggbb`: a cell of a map.
    pub fn cell(&mut self, colour: &str, corner: [f64; 2], size: [f64; 2], tip: &str) {
        if finite(&corner) && finite(&size) {
            let [x, y, w, h] = [corner[0], corner[1], size[0], size[1]].map(px);
            let _ = write!(
                self.text,
                "<rect class=\"cell\" fill=\"{colour}\" x=\"{x}\" y=\"{y}\" width=\"{w}\" height=\"{h}\""
            );
            self.tip("rect", tip);
        }
    }

    /// A circle; `tip` is its tooltip, if not empty.
    pub fn circle(&mut self, class: &str, centre: [f64; 2], radius: f64, tip: &str) {
        if finite(&centre) && radius.is_finite() {
            let [x, y, r] = [centre[0], centre[1], radius].map(px);
            let _ = write!(self.text, "<circle class=\"{class}\" cx=\"{x}\" cy=\"{y}\" r=\"{r}\"");
            self.tip("circle", tip);
        }
    }

    /// A polyline, broken where a point is not finite; `closed` joins the ends of an unbroken one.
    pub fn path(&mut self, class: &str, points: &[[f64; 2]], closed: bool) {
        let mut data = String::new();
        let mut pen_down = false;
        for point in points {
            if finite(point) {
                let [x, y] = point.map(px);
                let _ = write!(data, "{}{x} {y}", if pen_down { 'L' } else { 'M' });
            }
            pen_down = finite(point);
        }
        if closed && !points.is_empty() && points.iter().all(finite) {
            data.push('Z');
        }
        if !data.is_empty() {
            let _ = write!(self.text, "<path class=\"{class}\" d=\"{data}\"/>");
        }
    }

    /// A diagonal cross: the mark of an outlier.
    pub fn cross(&mut self, class: &str, [x, y]: [f64; 2], arm: f64) {
        self.line(class, [x - arm, y - arm], [x + arm, y + arm]);
        self.line(class, [x - arm, y + arm], [x + arm, y - arm]);
    }

    /// A text; `at` is on its baseline.
    pub fn text(&mut self, class: &str, at: [f64; 2], anchor: Anchor, text: &str) {
        if finite(&at) {
            let [x, y] = at.map(px);
            let _ = write!(
                self.text,
                "<text class=\"{class}\" x=\"{x}\" y=\"{y}\" text-anchor=\"{}\">{}</text>",
                anchor.word(),
                escape(text)
            );
        }
    }

    /// A text that reads upwards, about its middle.
    pub fn text_upwards(&mut self, class: &str, at: [f64; 2], text: &str) {
        if finite(&at) && !text.is_empty() {
            let [x, y] = at.map(px);
            let _ = write!(
                self.text,
                "<text class=\"{class}\" transform=\"translate({x} {y}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
                escape(text)
            );
        }
    }

    fn tip(&mut self, element: &str, tip: &str) {
        if tip.is_empty() {
            self.text.push_str("/>");
        } else {
            let _ = write!(self.text, "><title>{}</title></{element}>", escape(tip));
        }
    }
}

/// A picture as a file of its own, with its colours.
pub fn standalone(svg: &str) -> String {
    let named = svg.replacen("<svg ", "<svg xmlns=\"http://www.w3.org/2000/svg\" ", 1);
    named.replacen("<title>", &format!("<style>{PLOT_CSS}svg{{background:var(--paper)}}</style><title>"), 1)
}

pub(crate) fn plot_css() -> &'static str {
    PLOT_CSS
}

/// Escapes the five characters that have a meaning in XML.
fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for character in escape_controls(text).chars() {
        match character {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            // A line feed or a tab: XML has no other control characters.
            control if control.is_control() => escaped.push(' '),
            other => escaped.push(other),
        }
    }
    escaped
}

fn finite(point: &[f64; 2]) -> bool {
    point.iter().all(|value| value.is_finite())
}

/// A coordinate to a tenth of a pixel.
fn px(value: f64) -> String {
    let text = format!("{value:.1}");
    let text = text.strip_suffix(".0").unwrap_or(&text);
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}
