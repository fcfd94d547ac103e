//! The circumstances of a measurement: the further columns of a table.

use std::fmt::Write;

use serde::{Deserialize, Serialize};

use crate::robot::{AXES, CircleId};

/// The purpose of a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PoseKind {
    /// A dwell whose length is used for identification.
    Measure,
    /// A dwell at the repeated reference pose, for drift.
    Reference,
    /// No dwell: an approach, a sync marker, or the auxiliary point of the next pose.
    Transit,
}

impl PoseKind {
    const WORDS: [(Self, &'static str); 3] =
        [(Self::Measure, "measure"), (Self::Reference, "reference"), (Self::Transit, "transit")];
}

/// The circumstances of a measurement besides pose and length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeasurementContext {
    pub kind: Option<PoseKind>,
    /// Middle of the dwell, s since the start of the run.
    pub time_s: Option<f64>,
    /// Number of averaged samples.
    pub samples: Option<usize>,
    /// Whether the reading drifted within the dwell.
    pub creep: Option<bool>,
    pub circle: Option<CircleId>,
    /// The angle of the pose on its circle.
    pub angle_deg: Option<f64>,
    /// Temperature of the bar, degrees Celsius.
    pub temperature_c: Option<f64>,
    /// The controller's axis angles at which the tool ball touched the place of the base ball, degrees.
    pub taught_deg: Option<Box<[f64; AXES]>>,
    /// Force with which the bar pulled the tool ball towards the base ball, N.
    pub force_n: Option<f64>,
    /// Cells by their column's number that the fields do not reproduce: the user's own columns, and other spellings of a
    /// value.
    pub texts: Vec<(usize, Box<str>)>,
}

/// A further column of a table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ContextColumn {
    Kind,
    TimeS,
    Samples,
    Creep,
    Circle,
    AngleDeg,
    TemperatureC,
    TaughtDeg,
    ForceN,
    /// A column of the user.
    Other(String),
}

impl ContextColumn {
    const NAMED: [(Self, &'static str); 9] = [
        (Self::Kind, "kind"),
        (Self::TimeS, "t_s"),
        (Self::Samples, "samples"),
        (Self::Creep, "creep"),
        (Self::Circle, "circle"),
        (Self::AngleDeg, "angle_deg"),
        (Self::TemperatureC, "temp_c"),
        (Self::TaughtDeg, "taught_deg"),
        (Self::ForceN, "force_n"),
    ];

    pub fn of(name: &str) -> Self {
        let named = Self::NAMED.into_iter().find(|(_, known)| *known == name);
        named.map_or_else(|| Self::Other(name.into()), |(column, _)| column)
    }

    pub fn name(&self) -> &str {
        if let Self::Other(name) = self {
            return name;
        }
        Self::NAMED.iter().find(|(column, _)| column == self).map_or("", |(_, name)| name)
    }
}

impl MeasurementContext {
    /// Parses the cells of a row, one per column.
    pub(super) fn read(columns: &[ContextColumn], cells: impl Iterator<Item = String>) -> Self {
        let mut context = Self::default();
        for (at, (column, cell)) in columns.iter().zip(cells).enumerate() {
            let cell = cell.as_str();
            if cell.is_empty() {
                continue;
            }
            match column {
                ContextColumn::Kind => {
                    context.kind =
                        PoseKind::WORDS.into_iter().find(|(_, word)| *word == cell).map(|(kind, _)| kind);
                }
                ContextColumn::TimeS => context.time_s = cell.parse().ok(),
                ContextColumn::Samples => context.samples = cell.parse().ok(),
                ContextColumn::Creep => context.creep = ["0", "1"].contains(&cell).then_some(cell == "1"),
                ContextColumn::Circle => context.circle = cell.parse().ok().and_then(CircleId::new),
                ContextColumn::AngleDeg => context.angle_deg = cell.parse().ok(),
                ContextColumn::TemperatureC => context.temperature_c = cell.parse().ok(),
                ContextColumn::TaughtDeg => context.taught_deg = angles(cell).map(Box::new),
                ContextColumn::ForceN => context.force_n = cell.parse().ok(),
                ContextColumn::Other(_) => {}
            }
            if context.field(column) != cell {
                context.texts.push((at, cell.into()));
            }
        }
        context
    }

    /// The cell of column number `at`, spelled as it was read.
    pub fn cell(&self, at: usize, column: &ContextColumn) -> String {
        match self.texts.iter().find(|(place, _)| *place == at) {
            Some((_, text)) => text.to_string(),
            None => self.field(column),
        }
    }

    /// A field as it is written; empty if it is not known.
    fn field(&self, column: &ContextColumn) -> String {
        let text = match column {
            ContextColumn::Kind => self.kind.map(|kind| PoseKind::WORDS[kind as usize].1.to_owned()),
            ContextColumn::TimeS => self.time_s.map(|t_s| format!("{t_s:.4}")),
            ContextColumn::Samples => self.samples.map(|count| count.to_string()),
            ContextColumn::Creep => self.creep.map(|creep| u8::from(creep).to_string()),
            ContextColumn::Circle => self.circle.map(|circle| circle.to_string()),
            ContextColumn::AngleDeg => self.angle_deg.map(|deg| deg.to_string()),
            ContextColumn::TemperatureC => self.temperature_c.map(|c| format!("{c:.2}")),
            ContextColumn::TaughtDeg => {
                self.taught_deg.as_ref().map(|axes| axes.map(|deg| deg.to_string()).join(" "))
            }
            ContextColumn::ForceN => self.force_n.map(|newtons| newtons.to_string()),
            ContextColumn::Other(_) => None,
        };
        text.unwrap_or_default()
    }

    /// The same in a table in which column number `at` has the number `places[at]`.
    pub(super) fn in_columns(&self, places: &[usize]) -> Self {
        let texts = self.texts.iter().map(|(at, text)| (places[*at], text.clone()));
        Self { texts: texts.collect(), ..self.clone() }
    }

    /// Appends the cells of all columns, each after a comma.
    pub(super) fn append(&self, columns: &[ContextColumn], text: &mut String) {
        for (at, column) in columns.iter().enumerate() {
            // Writing to a string does not fail.
            let _ = write!(text, ",{}", quoted(&self.cell(at, column)));
        }
    }
}

/// Six angles separated by blanks.
fn angles(cell: &str) -> Option<[f64; AXES]> {
    let angles: Option<Vec<f64>> = cell.split(' ').map(|angle| angle.parse().ok()).collect();
    angles?.try_into().ok()
}

/// A CSV cell, quoted if necessary.
pub(super) fn quoted(cell: &str) -> String {
    if cell.contains(['"', ',', ';', '\t', '\n', '\r']) {
        format!("\"{}\"", cell.replace('"', "\"\""))
    } else {
        cell.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_keep_their_spelling_and_known_columns_are_parsed() {
        let columns = ["kind", "note", "t_s", "circle", "samples"].map(ContextColumn::of);
        let rows = [
            ["measure", "1, 2", "0.5000", "3", "12"],
            ["warm-up", "say \"so\"", "0.5", "A3", "1e3"],
            ["", "two\nlines", "", "0", ""],
        ];
        for row in rows {
            let context = MeasurementContext::read(&columns, row.into_iter().map(str::to_owned));
            let cells = columns.iter().enumerate().map(|(at, column)| context.cell(at, column));
            assert_eq!(cells.collect::<Vec<_>>(), row);
        }
        let context = MeasurementContext::read(&columns, rows[0].into_iter().map(str::to_owned));
        assert_eq!(
            (context.kind, context.time_s, context.circle),
            (Some(PoseKind::Measure), Some(0.5), CircleId::new(3))
        );
        let other = MeasurementContext::read(&columns, rows[1].into_iter().map(str::to_owned));
        assert_eq!((other.kind, other.time_s, other.circle, other.samples), (None, Some(0.5), None, None));
    }
}
