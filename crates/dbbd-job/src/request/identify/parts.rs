//! The parts of one measurement: captures and tables of one robot that are evaluated together, each with its set-up.
//!
//! Two parts with one set-up share the base balls and the zero of the bar; whether a ball or the zero moved between the
//! parts is tested like any change within a run. In another set-up the base balls may be anywhere, and the bar has
//! another zero.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::matched_run::MatchedRun;
use super::tables::{lengths_or_positions, measurements};
use crate::plan::is_same_planned_pose;
use crate::request::RequestSession;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::EstimationFinding;
use dbbd_model::measurement::{BaseBall, Measurement, MeasurementFinding, Measurements};
use dbbd_model::provenance::{ArtefactRole, Identity, TracedArtefact};
use dbbd_model::robot::{AXES, BallId, BarId, Datum};

/// The relation between the set-ups of consecutive parts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SetUpRelation {
    /// One set-up if both were measured on one day with the same bar and the same balls.
    #[default]
    ByDay,
    Same,
    New,
}

/// The numbers that a set-up adds to the numbers of its part.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct SetUpNumbers {
    pub(super) first_ball: usize,
    first_bar: usize,
}

impl SetUpNumbers {
    /// The first bar of the set-up.
    pub(super) fn bar(self) -> BarId {
        BarId::at(self.first_bar)
    }

    fn datum(self, datum: Datum) -> Datum {
        match datum {
            Datum::Ball(ball, bar) => Datum::Ball(
                BallId::at(self.first_ball + ball.index()),
                BarId::at(self.first_bar + bar.index()),
            ),
            Datum::Plane(_) => datum,
        }
    }
}

/// A capture or a table.
pub(super) struct InputPart {
    pub(super) path: PathBuf,
    pub(super) lengths: TracedArtefact,
    /// The measurements as they were read.
    pub(super) measurements: Measurements,
    pub(super) matched: Option<MatchedRun>,
    pub(super) set_up: SetUpNumbers,
    /// The commanded axis angles by the index of their row, rad; empty for a table.
    commanded: BTreeMap<u32, [f64; AXES]>,
    /// Whether the part measures poses again.
    supersedes: bool,
}

impl InputPart {
    /// Whether the part has a length at a pose: base ball, and commanded axis angles in rad.
    pub(super) fn has(&self, (ball, axes): &(BallId, [f64; AXES])) -> bool {
        self.measurements.rows.iter().any(|row| {
            row.datum.ball() == Some(*ball)
                && self.commanded.get(&row.index).is_some_and(|own| is_same_planned_pose(own, axes))
        })
    }

    fn new(
        path: PathBuf,
        lengths: TracedArtefact,
        measurements: Measurements,
        matched: Option<MatchedRun>,
    ) -> Self {
        let plan = matched.as_ref().map(|matched| &matched.run.plan);
        let supersedes = plan.is_some_and(|plan| plan.header.again);
        let rows = plan.iter().flat_map(|plan| &plan.rows);
        let commanded = rows.map(|row| (row.index, row.axes_deg.map(f64::to_radians))).collect();
        Self { path, lengths, measurements, matched, set_up: SetUpNumbers::default(), commanded, supersedes }
    }

    pub(super) fn read(
        path: &Path,
        session: &RequestSession<'_>,
        findings: &mut Vec<Diagnostic>,
    ) -> Result<Self, Diagnostic> {
        let (measurements, lengths, matched) = match MatchedRun::read(path, session)? {
            Some(matched) => {
                (matched.matching.observations.clone(), matched.run.traced(path)?, Some(matched))
            }
            None => {
                let read = measurements(path, lengths_or_positions, findings, session)?;
                let (lengths, changed) = crate::artefact::of_table(ArtefactRole::Measurements, path)?;
                findings.extend(changed);
                (read, lengths, None)
            }
        };
        if measurements.rows.is_empty() {
            return Err(Diagnostic::file(path.display(), EstimationFinding::NoLength));
        }
        Ok(Self::new(path.into(), lengths, measurements, matched))
    }

    /// Whether one of two parts has the lengths of the other. Where a part measures poses again, its lengths replace the
    /// others.
    pub(super) fn counts_twice(&self, other: &Self) -> bool {
        !self.supersedes && !other.supersedes && self.measurements.repeats(&other.measurements)
    }

    /// Whether a part that was measured after `before` has the same set-up, by the data that both state.
    fn follows(&self, before: &Self) -> bool {
        let [earlier, later] = [before, self].map(|part| &part.lengths.provenance.identity);
        let day = |identity: &Identity| {
            identity.measured.as_deref().and_then(|date| date.split('T').next()).map(str::to_owned)
        };
        let (days, contradictions) = ([day(earlier), day(later)], earlier.contradictions(later));
        let same_places = match (&before.matched, &self.matched) {
            (Some(before), Some(own)) => own.run.plan.keeps_base_balls_of(&before.run.plan),
            _ => true,
        };
        days[0].is_some()
            && days[0] == days[1]
            && same_places
            && !contradictions
                .iter()
                .any(|other| other.key.starts_with("bar.") || other.key.starts_with(Identity::BALLS))
    }
}

/// Sorts parts by the times of day at which they were measured, if all have one: a pose that was measured again
/// replaces the earlier one, in whatever order the files were given. Captures of one second are sorted by their clock.
pub(super) fn sort_by_time(parts: &mut [InputPart]) {
    let time = |part: &InputPart| part.lengths.provenance.identity.measured.clone();
    let started = |part: &InputPart| part.matched.as_ref().and_then(|matched| matched.run.started);
    if parts.iter().all(|part| time(part).is_some_and(|time| time.contains('T'))) {
        parts.sort_by_key(|part| (time(part), started(part)));
    }
}

/// The measurements of all parts, and the base balls of all set-ups.
pub(super) struct JoinedParts {
    pub(super) measurements: Measurements,
    pub(super) centres: Vec<BaseBall>,
}

impl JoinedParts {
    /// Gives each part its set-up. `centres` are the base balls of the first part.
    pub(super) fn of(
        parts: &mut [InputPart],
        centres: Vec<BaseBall>,
        relation: SetUpRelation,
        findings: &mut Vec<Diagnostic>,
    ) -> Result<Self, Diagnostic> {
        let of_first = centres.clone();
        let mut all = centres;
        for at in 1..parts.len() {
            let (earlier, later) = parts.split_at_mut(at);
            let (Some(before), Some(part)) = (earlier.last(), later.first_mut()) else { continue };
            let same = match relation {
                SetUpRelation::Same => true,
                SetUpRelation::New => false,
                SetUpRelation::ByDay => part.follows(before),
            };
            part.set_up = before.set_up;
            if !same {
                part.set_up.first_ball = all.len();
                part.set_up.first_bar += before.measurements.bars();
            }
            // A part with the same set-up may have one more ball.
            let first_ball = part.set_up.first_ball;
            let own = part.matched.as_ref().map(|matched| matched.run.centres());
            let own = own.unwrap_or_else(|| of_first.clone()).into_iter();
            let further = own.filter(|ball| first_ball + ball.id.index() >= all.len());
            let further: Vec<BaseBall> = further
                .map(|ball| BaseBall { id: BallId::at(first_ball + ball.id.index()), ..ball })
                .collect();
            all.extend(further);
            let (first_ball, bar) = (part.set_up.first_ball + 1, part.set_up.bar().number());
            let joined = match same {
                true => EstimationFinding::PartOfSameSetUp,
                false => EstimationFinding::PartOfNewSetUp { first_ball, bar },
            };
            findings.push(Diagnostic::file(part.path.display(), joined));
        }
        let (measurements, superseded) = joined(parts)?;
        findings.extend((!superseded.is_empty()).then(|| {
            let rows = superseded.iter().map(u32::to_string).collect::<Vec<_>>().join(", ");
            Diagnostic::from(EstimationFinding::Superseded { count: superseded.len(), rows })
        }));
        Ok(Self { measurements, centres: all })
    }
}

/// The measurements of all parts: the indices and times of each part continue those of the part before. Also returns
/// the indices of measurements that a later part measured again on request; they are left out.
pub(super) fn joined(parts: &[InputPart]) -> Result<(Measurements, Vec<u32>), MeasurementFinding> {
    let (mut all, mut superseded) = (Measurements::default(), Vec::new());
    let (mut last_index, mut last_s) = (0, 0.0);
    for (at, part) in parts.iter().enumerate() {
        let mut own = part.measurements.clone();
        // The balls of two parts are compared by the numbers in their own files.
        let again = |row: &Measurement| {
            let mut later = parts[at + 1..].iter().filter(|later| later.supersedes);
            later.any(|later| {
                later.measurements.rows.iter().any(|new| is_same_pose((part, row), (later, new)))
            })
        };
        superseded.extend(own.rows.iter().filter(|row| again(row)).map(|row| row.index + last_index));
        own.rows.retain(|row| !again(row));
        for row in &mut own.rows {
            row.index += last_index;
            row.datum = part.set_up.datum(row.datum);
        }
        own.delay(last_s);
        last_index += part.measurements.rows.iter().map(|row| row.index).max().unwrap_or(0);
        last_s += part.measurements.rows.iter().filter_map(time_s).fold(0.0, f64::max);
        if at == 0 {
            all = own;
            continue;
        }
        all = all.and(&own)?;
    }
    Ok((all, superseded))
}

fn time_s(row: &Measurement) -> Option<f64> {
    row.context.as_ref()?.time_s
}

/// Whether two lengths are of one pose. A plan that measures again has the commanded poses of the earlier plan or, made from
/// a table or a result, the axes of its rows, which may be measured ones.
fn is_same_pose((earlier, a): (&InputPart, &Measurement), (later, b): (&InputPart, &Measurement)) -> bool {
    let poses = |part: &InputPart, row: &Measurement| {
        [Some(row.axes.radians()), part.commanded.get(&row.index).copied()]
    };
    (a.target, a.datum) == (b.target, b.datum)
        && poses(earlier, a)
            .iter()
            .flatten()
            .any(|a| poses(later, b).iter().flatten().any(|b| is_same_planned_pose(a, b)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use dbbd_model::provenance::Artefact;

    fn part(rows: &[(u32, u32, f64, f64)], first_ball: usize, first_bar: usize) -> InputPart {
        let header = "index,centre,a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg,length_mm,t_s\n";
        let row = |(index, ball, axis, length): &(u32, u32, f64, f64)| {
            format!("{index},{ball},{axis},0,0,0,0,0,{length},{index}\n")
        };
        let text = [header.to_owned(), rows.iter().map(row).collect()].concat();
        let measurements = Measurements::from_csv("t.csv", &text).unwrap();
        let lengths = TracedArtefact::from(Artefact::new(ArtefactRole::Measurements, "t.csv", text));
        InputPart {
            set_up: SetUpNumbers { first_ball, first_bar },
            ..InputPart::new("t.csv".into(), lengths, measurements, None)
        }
    }

    #[test]
    fn parts_keep_their_balls_bars_and_order() {
        let parts = [
            part(&[(3, 1, 1.0, 300.0), (7, 2, 2.0, 301.0)], 0, 0),
            part(&[(2, 1, 1.0, 300.5), (3, 2, 3.0, 302.0)], 2, 1),
        ];
        let (joined, superseded) = joined(&parts).unwrap();
        assert!(superseded.is_empty());
        let rows: Vec<_> = joined
            .rows
            .iter()
            .map(|row| {
                (
                    row.index,
                    row.datum.ball().unwrap().number(),
                    row.datum.bar().unwrap().number(),
                    time_s(row).unwrap(),
                )
            })
            .collect();
        assert_eq!(rows, [(3, 1, 1, 3.0), (7, 2, 1, 7.0), (9, 3, 2, 9.0), (10, 4, 2, 10.0)]);
    }

    #[test]
    fn lengths_of_another_part_count_twice_unless_they_replace_them() {
        let whole = part(&[(3, 1, 1.0, 300.0), (7, 2, 2.0, 301.0)], 0, 0);
        let mut copy = part(&[(1, 2, 2.0, 301.0004)], 0, 0);
        let both = |other: &InputPart| [whole.counts_twice(other), other.counts_twice(&whole)];
        assert_eq!(both(&copy), [true; 2]);
        copy.supersedes = true;
        assert_eq!(both(&copy), [false; 2]);
    }

    /// The pose of two balls is measured again to the second one, in another set-up: only the length to this ball is replaced, and
    /// the numbers go on as if it were still there.
    #[test]
    fn a_length_that_is_measured_again_replaces_the_one_to_the_same_ball() {
        let mut parts = [
            part(&[(1, 1, 5.0, 300.0), (2, 2, 5.0, 301.0)], 0, 0),
            part(&[(1, 2, 5.0, 301.5)], 2, 1),
            part(&[(1, 1, 7.0, 299.0)], 2, 1),
        ];
        parts[1].supersedes = true;
        let (joined, superseded) = joined(&parts).unwrap();
        assert_eq!(superseded, [2]);
        let rows: Vec<_> = joined.rows.iter().map(|row| (row.index, row.length_mm)).collect();
        assert_eq!(rows, [(1, 300.0), (3, 301.5), (4, 299.0)]);
    }

    /// Measured angles differ from visit to visit by some thousandths of a degree. The second plan has the commanded pose, or
    /// that of a table with the measured angles.
    #[test]
    fn a_pose_that_is_measured_again_is_recognised_by_its_commanded_angles() {
        let superseded_by = |commanded_deg: f64| {
            let mut parts = [
                part(&[(1, 1, 5.003, 300.0), (2, 1, 7.0, 301.0)], 0, 0),
                part(&[(1, 1, 4.998, 300.1)], 0, 0),
            ];
            let commanded = |deg: f64| BTreeMap::from([(1, [deg.to_radians(), 0.0, 0.0, 0.0, 0.0, 0.0])]);
            parts[0].commanded = commanded(5.0);
            (parts[1].commanded, parts[1].supersedes) = (commanded(commanded_deg), true);
            joined(&parts).unwrap().1
        };
        assert_eq!([5.0, 5.003, 5.01].map(superseded_by), [vec![1], vec![1], vec![]]);
    }

    /// One part has columns that the other one lacks: its times count on, and what only one part states is kept.
    #[test]
    fn parts_with_other_columns_keep_their_times() {
        let text = "index,centre,a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg,length_mm,note,temp_c,t_s\n\
                    1,1,9,0,0,0,0,0,303,late,21.50,2\n";
        let second = InputPart {
            measurements: Measurements::from_csv("t.csv", text).unwrap(),
            ..part(&[(1, 1, 9.0, 303.0)], 0, 0)
        };
        let first = part(&[(1, 1, 5.0, 300.0), (2, 1, 7.0, 301.0)], 0, 0);
        let (joined, _) = joined(&[first, second]).unwrap();
        assert_eq!(joined.rows.iter().filter_map(time_s).collect::<Vec<f64>>(), [1.0, 2.0, 4.0]);
        assert_eq!(joined.mean_temperature_c(), Some(21.5));
        let written = joined.to_csv();
        assert!(written.ends_with(",4.0000,late,21.50\n"), "{written}");
        assert_eq!(Measurements::from_csv("t.csv", &written).unwrap(), joined);
    }
}
