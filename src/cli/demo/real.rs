//! `dbbd demo --real`: a robot that others measured with a laser tracker. Lengths to three base balls are computed from the
//! tracker's positions, as a bar without noise would read them. The identified robot is judged at poses that it did not see.

use std::path::Path;

use nalgebra::Vector3;
use serde::Serialize;

use dbbd_job::files;
use dbbd_model::base::InternalFinding;
use dbbd_model::base::table::TableReader;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::Positions;
use dbbd_model::math::RigidAlignment;
use dbbd_model::measurement::{
    ApproachedPose, AxisAngles, BallId, BarId, BaseBall, Datum, Measurement, Measurements, TargetId,
};
use dbbd_model::robot::{Approach, PayloadId, Robot};

/// A robot whose measurements are part of the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum RealRobot {
    Ur5,
    Ur10,
}

/// Base balls beside the mean of the positions, in units of a thousandth of their mean extent: far from a line, and from the
/// plane of any circle of poses.
const BALLS: [[f64; 3]; 3] = [[0.0, 0.0, -500.0], [400.0, 300.0, 0.0], [-300.0, 400.0, 200.0]];
/// The places of the balls are given as a user would tape them, mm.
const TAPED_MM: f64 = 10.0;
/// Of the UR10's random poses every ninth identifies: about 300.
const SEEN_EVERY: usize = 9;

/// What is known of a real robot.
pub(super) struct TrackedRobot {
    name: &'static str,
    /// Rough place of the tracker's target on the flange, mm.
    tool_mm: [f64; 3],
    licence: &'static str,
    seen: Vec<TrackedPose>,
    kept: Vec<TrackedPose>,
    published: Option<PublishedError>,
}

struct TrackedPose {
    pose: ApproachedPose,
    /// In the tracker's frame, mm.
    place: Vector3<f64>,
}

/// The mean 3-D error that the authors of the measurements state, mm.
#[derive(Clone, Copy, Debug, Serialize)]
struct PublishedError {
    before_mm: f64,
    after_mm: f64,
    source: &'static str,
}

/// The error at the kept poses, in the frame that fits the seen poses best, mm.
#[derive(Debug, Serialize)]
pub(super) struct HeldOutError {
    robot: String,
    seen_poses: usize,
    kept_poses: usize,
    mean_mm: f64,
    largest_mm: f64,
    rms_mm: f64,
    /// The root mean square that the identification predicts.
    predicted_rms_mm: f64,
    published: Option<PublishedError>,
}

impl RealRobot {
    /// What is known of it.
    pub(super) fn tracked(self) -> Result<TrackedRobot, Diagnostic> {
        match self {
            Self::Ur5 => Ok(TrackedRobot {
                name: "ur5",
                tool_mm: [0.0, 0.0, 30.0],
                licence: include_str!("../../../fixtures/real/ur5/LICENSE"),
                seen: TrackedPose::read("grid.csv", include_str!("../../../fixtures/real/ur5/grid.csv"))?,
                kept: TrackedPose::read("random.csv", include_str!("../../../fixtures/real/ur5/random.csv"))?,
                published: Some(PublishedError {
                    before_mm: 2.5664,
                    after_mm: 0.1549,
                    source: "P. Jacobi, A Hybrid Error Compensation Method for Enhancing the Pose Accuracy of Serial \
                             Industrial Robots, Tsinghua University, 2025",
                }),
            }),
            Self::Ur10 => {
                let text = include_str!("../../../fixtures/real/ur10/random.csv");
                let all = TrackedPose::read("random.csv", text)?.into_iter().enumerate();
                let (seen, kept): (Vec<_>, Vec<_>) = all.partition(|(at, _)| at % SEEN_EVERY == 0);
                let poses = |numbered: Vec<(usize, TrackedPose)>| numbered.into_iter().map(|(_, pose)| pose);
                Ok(TrackedRobot {
                    name: "ur10",
                    tool_mm: [0.0, 0.0, 93.0],
                    licence: include_str!("../../../fixtures/real/ur10/LICENSE"),
                    seen: poses(seen).collect(),
                    kept: poses(kept).collect(),
                    published: None,
                })
            }
        }
    }
}

impl TrackedPose {
    /// Reads a series in the order in which it was measured, which tells the sense in which each axis came to its pose.
    fn read(file: &str, text: &str) -> Result<Vec<Self>, Diagnostic> {
        let table = Measurements::positions_from_table(&mut TableReader::of(file, text)?)?;
        let positions: Vec<_> = table.positions().collect();
        let approaches = Approach::along(positions.iter().map(|position| position.axes));
        let poses = positions.iter().zip(approaches).map(|(position, approach)| {
            let axes = AxisAngles::from_degrees(position.axes.map(f64::to_degrees));
            Self { pose: ApproachedPose { axes, approach }, place: position.place }
        });
        Ok(poses.collect())
    }
}

impl TrackedRobot {
    /// Its name among the built-in robots.
    pub(super) fn name(&self) -> &'static str {
        self.name
    }

    /// The rough place of the target, as the option `--tool` takes it.
    pub(super) fn tool(&self) -> String {
        self.tool_mm.map(|mm| mm.to_string()).join(",")
    }

    /// Writes the lengths of the seen poses, the taped places of the balls, and the licence of the measurements.
    pub(super) fn write(&self, dir: &Path, nominal: &Robot) -> Result<(), Diagnostic> {
        let balls = self.balls();
        files::write_file(&dir.join("LICENSE"), self.licence)?;
        files::write_file(&dir.join("observations.csv"), self.lengths(&balls).to_csv())?;
        files::write_file(&dir.join("centres.csv"), BaseBall::to_csv(&self.taped(&balls, nominal)?))
    }

    /// Base balls in the tracker's frame, mm.
    fn balls(&self) -> [Vector3<f64>; 3] {
        let places = || self.seen.iter().map(|seen| seen.place);
        let mean = places().sum::<Vector3<f64>>() / self.seen.len() as f64;
        let far = Vector3::repeat(f64::INFINITY);
        let (low, high) = places().fold((far, -far), |(low, high), at| (low.inf(&at), high.sup(&at)));
        BALLS.map(|ball| mean + Vector3::from(ball) * ((high - low).mean() / 1000.0))
    }

    /// The lengths of the seen poses.
    fn lengths(&self, balls: &[Vector3<f64>; 3]) -> Measurements {
        let pairs = self.seen.iter().flat_map(|seen| balls.iter().enumerate().map(move |pair| (seen, pair)));
        let length =
            |(index, (seen, (at, ball))): (u32, (&TrackedPose, (usize, &Vector3<f64>)))| Measurement {
                index,
                datum: Datum::Ball(BallId::at(at), BarId::FIRST),
                target: TargetId::FIRST,
                axes: seen.pose.axes,
                approach: seen.pose.approach,
                length_mm: (seen.place - ball).norm(),
                sigma_mm: None,
                payload: PayloadId::FIRST,
                context: None,
            };
        Measurements { rows: (1..).zip(pairs).map(length).collect(), ..Measurements::default() }
    }

    /// The places of the balls in the base of the nominal robot, rounded.
    fn taped(&self, balls: &[Vector3<f64>; 3], nominal: &Robot) -> Result<Vec<BaseBall>, Diagnostic> {
        let mut nominal = nominal.clone();
        nominal.set_tool(self.tool_mm);
        let there: Vec<_> =
            self.seen.iter().map(|seen| nominal.geometry.ball(&seen.pose.axes.radians()).position).collect();
        let places: Vec<_> = self.seen.iter().map(|seen| seen.place).collect();
        let into_base = motion(&places, &there)?;
        let taped = |place| into_base.apply(place).map(|mm| (mm / TAPED_MM).round() * TAPED_MM + 0.0);
        Ok((0..)
            .zip(balls)
            .map(|(at, ball)| BaseBall { id: BallId::at(at), position: taped(ball) })
            .collect())
    }

    /// Where the identified robot says that the target was at the kept poses, beside where it was.
    pub(super) fn judge(&self, identified: &Robot) -> Result<HeldOutError, Diagnostic> {
        let all = || self.seen.iter().chain(&self.kept);
        let positions = Positions::of(identified, &all().map(|tracked| tracked.pose).collect::<Vec<_>>());
        let places: Vec<_> = all().map(|tracked| tracked.place).collect();
        let seen = self.seen.len();
        let into_tracker = motion(&positions.balls[..seen], &places[..seen])?;
        let error = |at: usize| (into_tracker.apply(&positions.balls[at]) - places[at]).norm();
        let errors: Vec<f64> = (seen..places.len()).map(error).collect();
        let mean = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / errors.len() as f64;
        Ok(HeldOutError {
            robot: identified.name.clone(),
            seen_poses: seen,
            kept_poses: errors.len(),
            mean_mm: mean(&mut errors.iter().copied()),
            largest_mm: errors.iter().copied().fold(0.0, f64::max),
            rms_mm: mean(&mut errors.iter().map(|error| error * error)).sqrt(),
            predicted_rms_mm: mean(&mut (seen..places.len()).map(|at| positions.sd_mm(at).powi(2))).sqrt(),
            published: self.published,
        })
    }
}

fn motion(from: &[Vector3<f64>], to: &[Vector3<f64>]) -> Result<RigidAlignment, InternalFinding> {
    let why = "the positions of a real robot do not span a frame".to_owned();
    RigidAlignment::of(from, to).ok_or(InternalFinding::NoSystem { why })
}

impl HeldOutError {
    /// The error on the terminal.
    pub(super) fn lines(&self) -> Vec<String> {
        let Self { robot, seen_poses, kept_poses, mean_mm, largest_mm, rms_mm, predicted_rms_mm, published } =
            self;
        let mut lines = vec![
            String::new(),
            format!(
                "{robot}: identified from {seen_poses} poses, judged at {kept_poses} poses that it did not see"
            ),
            format!("3-D error: mean {mean_mm:.3} mm, largest {largest_mm:.3} mm"),
            format!("           rms {rms_mm:.3} mm, predicted {predicted_rms_mm:.3} mm"),
        ];
        if let Some(PublishedError { before_mm, after_mm, source }) = published {
            lines.push(format!(
                "Published: mean {before_mm:.3} mm before, {after_mm:.3} mm after compensation ({source})"
            ));
        }
        lines
    }
}
