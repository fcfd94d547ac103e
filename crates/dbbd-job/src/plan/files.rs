//! A plan, and its files `plan.csv` and `plan.json`: a pair that belongs together.

use serde::de::IgnoredAny;
use serde::{Deserialize, Deserializer, Serialize};

use super::goal::outcome::GoalOutcome;
use super::pass::{self, PlannedPass};
use super::path::ToolBallPath;
use super::prediction::PlanPrediction;
use super::prior::TaughtBall;
use super::quantity::PlanCheck;
use super::rows::approaches;
use super::stage::Stage;
use super::timing::MoveTime;
use super::{Job, MotionKind, PlanRow, PlannedCircle, PoseKind};
use crate::plan::PlanFinding;
use dbbd_model::base::InternalFinding;
use dbbd_model::base::serialised;
use dbbd_model::base::table::wrong_csv;
use dbbd_model::conformity::change::CheckPower;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::measurement::table::APPROACH;
use dbbd_model::provenance::{Artefact, ArtefactRole, Provenance, TracedArtefact};
use dbbd_model::robot::{Approach, Robot};

/// Version of the form of `plan.json`.
pub(super) const PLAN_FILE_SCHEMA: u32 = 1;

/// The columns of `plan.csv`. The senses of approach come after them: they follow from the rows, are not read, and are absent
/// in files of older versions.
const COLUMNS: &str = "index,circle,centre,kind,move,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg,\
    a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg,status,turn,length_mm,dwell_s";

fn all_columns() -> String {
    format!("{COLUMNS},{}", APPROACH.join(","))
}

/// A plan: the rows of `plan.csv` and the header in `plan.json`.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    pub rows: Vec<PlanRow>,
    pub header: PlanHeader,
}

/// The content of `plan.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlanHeader {
    pub schema: u32,
    /// CRC-64/XZ over the text of `plan.csv` with job, robot, moves and passes, sixteen hexadecimal digits.
    pub hash: String,
    /// The same hash over both files, computed with these digits as 0; present only in a file. Absent in files of older
    /// versions, whose `hash` is the hash of `plan.csv` alone.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub text_hash: String,
    /// The seed of the time code: a hash over everything that the poses and the program depend on, sixteen hexadecimal
    /// digits. Absent in files of older versions, whose code was drawn from the seed of the job.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub pose_hash: String,
    pub job: Job,
    /// The text of the robot's file.
    pub robot: String,
    #[serde(default, skip_serializing_if = "Provenance::is_empty")]
    pub provenance: Provenance,
    /// One entry for each row, in order.
    pub moves: Vec<MoveTime>,
    /// The passes of continuous circles, in order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub passes: Vec<PlannedPass>,
    /// The worst value of each quantity that was checked.
    pub checks: Vec<PlanCheck>,
    /// Findings about the chosen poses; for people, not read back.
    #[serde(default, skip_serializing_if = "Vec::is_empty", with = "notes")]
    pub notes: Vec<PlanFinding>,
    /// The base balls that are to be taught before the bar is mounted; the stroke risk depends on them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub taught: Vec<TaughtBall>,
    /// Probability that a robot within its tolerance leaves the stroke anywhere while the bar is mounted.
    #[serde(default)]
    pub stroke_risk: f64,
    /// Whether the poses are measured again on request: their lengths supersede earlier ones at the same poses.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub again: bool,
    /// Present if not every pose that can be reached is allowed yet.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stage: Option<Stage>,
    /// What the run reaches of the job's goal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub goal: Option<GoalOutcome>,
    /// Predicted result of an identification with this plan; for people, not read back.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "not_read")]
    pub predictions: Option<PlanPrediction>,
    /// Predicted result of a check of a calibrated robot with this plan; for people, not read back.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "not_read")]
    pub check: Option<CheckPower>,
}

/// Findings with code, text and values.
mod notes {
    use serde::{Deserializer, Serializer};

    use super::{PlanFinding, not_read};
    use dbbd_model::diagnostic::Diagnostic;

    pub(super) fn serialize<S: Serializer>(notes: &[PlanFinding], out: S) -> Result<S::Ok, S::Error> {
        out.collect_seq(notes.iter().map(|note| Diagnostic::new(note.clone())))
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<PlanFinding>, D::Error> {
        not_read(from)
    }
}

/// Skips a value that is written for people.
fn not_read<'de, D: Deserializer<'de>, T: Default>(from: D) -> Result<T, D::Error> {
    IgnoredAny::deserialize(from).map(|_| T::default())
}

/// The place of a dwell on its circle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CirclePlace {
    /// Angle of its pose as rounded for the program, degrees from the plane's first axis, 0..360.
    pub angle_deg: f64,
    /// Whether the pass of the circle goes against growing angles.
    pub clockwise: bool,
    pub radius_mm: f64,
}

impl PlanRow {
    /// Checks what the types of the columns do not ensure; `at` is the position of the row from 0.
    fn check(&self, at: usize) -> Result<(), PlanFinding> {
        let &Self { index, status, turn, dwell_s, .. } = self;
        if index as usize != at + 1 {
            return Err(PlanFinding::RowIndex { index, expected: at + 1 });
        }
        let numbers = [self.length_mm, dwell_s].into_iter();
        let mut numbers = numbers.chain(self.xyz_mm).chain(self.abc_deg).chain(self.axes_deg);
        if let Some(value) = numbers.find(|value| !value.is_finite()) {
            return Err(PlanFinding::NotFinite { value });
        }
        if status > 7 || turn > 63 {
            return Err(PlanFinding::StatusTurn { status, turn });
        }
        let passed = self.is_passed() && self.motion == MotionKind::Circ;
        if (self.kind != PoseKind::Transit) != (dwell_s > 0.0) && !passed {
            return Err(PlanFinding::Dwell { dwell_s, kind: format!("{:?}", self.kind).to_lowercase() });
        }
        Ok(())
    }
}

impl Plan {
    /// The place of each row on its circle; `None` for transit rows and rows of no circle.
    pub fn circle_places(&self) -> Vec<Option<CirclePlace>> {
        let job = &self.header.job;
        let mut measured = vec![0_u32; job.circles.len()];
        self.rows
            .iter()
            .map(|row| {
                let table = job.circle(row.circle).filter(|_| row.kind != PoseKind::Transit)?;
                let circle = PlannedCircle::new(job, table, row.circle).ok()?;
                let visited = measured.get_mut(row.circle as usize - 1)?;
                let clockwise = table.is_clockwise(*visited >= table.points);
                *visited += u32::from(row.kind == PoseKind::Measure);
                let angle_deg = circle.angle_deg(row.xyz_mm.into());
                Some(CirclePlace { angle_deg, clockwise, radius_mm: circle.radius })
            })
            .collect()
    }

    /// The arc of a pass as its program drives it, through the printed points; `None` if the pass names rows that do not exist.
    pub fn pass_path(&self, planned: &PlannedPass) -> Option<ToolBallPath> {
        let at = |index: u32| self.rows.get((index as usize).checked_sub(1)?);
        let through = [at(planned.through[0])?, at(planned.through[1])?];
        Some(pass::arc(at(planned.through[0].checked_sub(1)?)?, through, at(planned.end)?, planned.sweep_deg))
    }

    /// The axis angles at which each base ball was taught, or is to be taught before this run.
    pub fn taught(&self) -> impl Iterator<Item = TaughtBall> {
        let tables = self.header.job.centres.iter();
        let before =
            tables.filter_map(|table| Some(TaughtBall { centre: table.id, axes_deg: table.taught_deg? }));
        before.chain(self.header.taught.iter().copied())
    }

    /// The job with the angles of [`Self::taught`].
    pub(crate) fn job_as_taught(&self) -> Job {
        let mut job = self.header.job.clone();
        for table in &mut job.centres {
            table.taught_deg = self.taught().find(|ball| ball.centre == table.id).map(|ball| ball.axes_deg);
        }
        job
    }

    /// Whether the base balls that an earlier plan has as well are at the same places. A ball that was taught at the same
    /// axis angles is: on an identified robot a plan knows its place better than the plan before.
    pub fn keeps_base_balls_of(&self, earlier: &Self) -> bool {
        let taught =
            |plan: &Self, id: u32| plan.taught().find(|ball| ball.centre == id).map(|ball| ball.axes_deg);
        self.header.job.centres.iter().all(|own| {
            let Some(other) = earlier.header.job.ball(own.id) else { return true };
            let is_taught_alike =
                taught(self, own.id).is_some() && taught(self, own.id) == taught(earlier, own.id);
            is_taught_alike || own.xyz_mm == other.xyz_mm
        })
    }
}

impl Plan {
    pub fn to_csv(&self) -> Result<String, InternalFinding> {
        rows_to_csv(&self.rows)
    }

    /// The sense in which the axes approach each row.
    pub fn approaches(&self) -> impl Iterator<Item = Approach> {
        approaches(&self.rows)
    }

    /// Whether the time code of the program depends on all poses.
    pub fn identifies_its_poses(&self) -> bool {
        !self.header.pose_hash.is_empty()
    }

    /// The `hash` that the header must have.
    pub(super) fn hash(&self) -> Result<String, InternalFinding> {
        let PlanHeader { job, robot, moves, passes, .. } = &self.header;
        Ok(hash_of([self.to_csv()?.as_str(), &serialised::json_line(&(job, robot, moves, passes))?]))
    }

    /// The plan as an artefact, with its provenance.
    pub fn traced(&self) -> Result<TracedArtefact, InternalFinding> {
        let artefact = Artefact::new(ArtefactRole::Plan, &self.header.hash, self.to_csv()?);
        Ok(TracedArtefact { artefact, provenance: self.header.provenance.clone() })
    }

    /// The texts of `plan.csv` and `plan.json`.
    pub fn to_files(&self) -> Result<(String, String), InternalFinding> {
        let mut header = self.header.clone();
        let csv = self.to_csv()?;
        header.hash = self.hash()?;
        header.text_hash = BLANK.into();
        let json = serialised::json(&header)? + "\n";
        let json = json.replacen(&text_hash(BLANK), &text_hash(&hash_of([csv.as_str(), &json])), 1);
        Ok((csv, json))
    }

    /// Reads a plan from its two files, and checks that they belong together.
    pub fn from_files(
        csv_name: &str,
        csv_text: &str,
        json_name: &str,
        json_text: &str,
    ) -> Result<Self, Diagnostic> {
        let rows = read_rows(csv_name, csv_text)?;
        let mut header: PlanHeader = serde_json::from_str(json_text).map_err(|error| {
            let finding = PlanFinding::NotHeader { why: error.to_string() };
            Diagnostic::position(json_name, json_text, error.line(), error.column(), finding)
        })?;
        let wrong = |finding: PlanFinding| Diagnostic::file(json_name, finding);
        if header.schema != PLAN_FILE_SCHEMA {
            return Err(wrong(PlanFinding::Schema { schema: header.schema, known: PLAN_FILE_SCHEMA }));
        }
        header.job.check().map_err(|misplaced| misplaced.finding.in_file(json_name))?;
        let indices = header.moves.iter().map(|time| time.index);
        if !indices.eq(rows.iter().map(|row| row.index)) {
            return Err(wrong(PlanFinding::Moves { rows: rows.len(), moves: header.moves.len() }));
        }
        pass::check_passes(&rows, &header.passes).map_err(wrong)?;
        let balls = header.job.centres.len();
        if let Some(row) = rows.iter().find(|row| header.job.ball(row.centre.number()).is_none()) {
            let finding = PlanFinding::NoSuchBall { ball: row.centre.number(), balls };
            return Err(Diagnostic::line(csv_name, row.index as usize + 1, finding));
        }
        let written = std::mem::take(&mut header.text_hash);
        let (hash, found) = if written.is_empty() {
            (header.hash.clone(), hash_of([csv_text]))
        } else {
            let blank = json_text.replacen(&text_hash(&written), &text_hash(BLANK), 1);
            (written, hash_of([csv_text, blank.as_str()]))
        };
        if hash != found {
            return Err(wrong(PlanFinding::OtherHash { other: csv_name.into(), hash, found }));
        }
        Ok(Self { rows, header })
    }
}

fn rows_to_csv(rows: &[PlanRow]) -> Result<String, InternalFinding> {
    let rows = rows.iter().zip(approaches(rows)).map(|(row, approach)| (row, approach.senses()));
    serialised::csv_table(all_columns().split(','), rows)
}

/// The hash over everything that the poses and the program depend on: the poses as they are printed, base balls, length of the
/// bar, robot and motion.
pub(super) fn pose_hash(rows: &[PlanRow], job: &Job, robot: &Robot) -> Result<u64, InternalFinding> {
    let balls: Vec<[f64; 3]> = job.centres.iter().map(|ball| ball.xyz_mm).collect();
    let set_up = serialised::json_line(&(&robot.name, balls, job.bar.length_mm, &job.motion))?;
    Ok(crc_of([rows_to_csv(rows)?.as_str(), &set_up]))
}

fn read_rows(name: &str, text: &str) -> Result<Vec<PlanRow>, Diagnostic> {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let columns = reader.headers().map_err(|error| wrong_csv(name, &error))?;
    let columns = columns.iter().collect::<Vec<_>>().join(",");
    if columns != COLUMNS && columns != all_columns() {
        return Err(Diagnostic::line(name, 1, PlanFinding::OtherColumns { columns: all_columns() }));
    }
    let mut rows: Vec<PlanRow> = Vec::new();
    for (at, record) in reader.records().enumerate() {
        let row = record.and_then(|record| record.deserialize(None));
        let row: PlanRow = row.map_err(|error| wrong_csv(name, &error))?;
        row.check(at).map_err(|finding| Diagnostic::line(name, at + 2, finding))?;
        rows.push(row);
    }
    if rows.is_empty() {
        return Err(Diagnostic::file(name, PlanFinding::NoRows));
    }
    pass::groups(&rows).map_err(|wrong| Diagnostic::line(name, wrong.at + 2, wrong.finding))?;
    Ok(rows)
}

fn hash_of<'a>(texts: impl IntoIterator<Item = &'a str>) -> String {
    digits(crc_of(texts))
}

/// The sixteen digits of a hash.
pub(super) fn digits(hash: u64) -> String {
    format!("{hash:016x}")
}

fn crc_of<'a>(texts: impl IntoIterator<Item = &'a str>) -> u64 {
    let crc = crc::Crc::<u64>::new(&crc::CRC_64_XZ);
    let mut digest = crc.digest();
    texts.into_iter().for_each(|text| digest.update(text.as_bytes()));
    digest.finalize()
}

/// The digits of a text hash that is not computed yet.
const BLANK: &str = "0000000000000000";

/// The entry of the hash of both files in `plan.json`.
fn text_hash(digits: &str) -> String {
    format!("\"text_hash\": \"{digits}\"")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::example::row;
    use dbbd_model::diagnostic::Finding;

    /// The check value of CRC-64/XZ in the catalogue of parametrised CRC algorithms (Cook): 995dc9bbdf1939fa.
    #[test]
    fn hash_is_crc_64_xz_over_all_texts() {
        assert_eq!(hash_of(["123456789"]), "995dc9bbdf1939fa");
        assert_eq!(hash_of(["1234", "", "56789"]), "995dc9bbdf1939fa");
    }

    #[test]
    fn a_row_has_a_base_ball() {
        let text =
            |centre: &str| format!("{COLUMNS}\n1,1,{centre},measure,ptp,{}0,0,300,1\n", "0,".repeat(12));
        let read = |centre: &str| read_rows("plan.csv", &text(centre));
        assert_eq!(read("2").unwrap()[0].centre.number(), 2);
        assert!(read("0").is_err() && read("").is_err());
    }

    #[test]
    fn impossible_rows_are_refused() {
        let measured = PlanRow { dwell_s: 1.0, ..row(PoseKind::Measure) };
        assert!(measured.check(0).is_ok());
        assert!(matches!(measured.check(1), Err(PlanFinding::RowIndex { index: 1, expected: 2 })));
        let wrong = |change: fn(&mut PlanRow)| {
            let mut row = measured.clone();
            change(&mut row);
            row.check(0).map_err(|finding| finding.code())
        };
        for (change, expected) in [
            ((|row| row.abc_deg[2] = f64::NAN) as fn(&mut PlanRow), PlanFinding::NotFinite { value: 0.0 }),
            (|row| row.status = 8, PlanFinding::StatusTurn { status: 8, turn: 0 }),
            (|row| row.turn = 64, PlanFinding::StatusTurn { status: 0, turn: 64 }),
            (|row| row.dwell_s = 0.0, PlanFinding::Dwell { dwell_s: 0.0, kind: String::new() }),
            (|row| row.kind = PoseKind::Transit, PlanFinding::Dwell { dwell_s: 0.0, kind: String::new() }),
        ] {
            assert_eq!(wrong(change), Err(expected.code()));
        }
        assert!(wrong(|row| (row.status, row.turn) = (7, 63)).is_ok());
        // A point that is passed has no dwell.
        assert!(wrong(|row| (row.dwell_s, row.motion) = (0.0, MotionKind::Circ)).is_ok());
    }
}
