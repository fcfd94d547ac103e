//! `dbbd predict`: where the tool ball is at axis angles.

use std::error::Error;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::{Outcome, Output, robots};
use crate::base::files;
use crate::catalogue::CliFinding;
use crate::diagnostic::Diagnostic;
use crate::estimation::Positions;
use crate::measurement::{self, APPROACH, Measurements};
use crate::robot::Robot;

/// Predict where the tool ball is at axis angles, with its uncertainty, by any robot file.
///
/// With it an identified robot can be compared with a tracker. Backlash counts where the sense of approach is given;
/// where it is not known its variance is added. Where a joint's angle was not measured, so is that of its smooth error.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Poses: CSV a1_deg,..,a6_deg[,approach1,..,approach6], the controller's axis angles and the sense of each axis's
    /// last move (1 by rising angles, -1 by falling ones, 0 or absent: not known).
    axes: PathBuf,
    /// Robot: a built-in name or a TOML file, such as robot-identified.toml.
    #[arg(long, value_name = "NAME|FILE")]
    robot: String,
    /// Table to write: the columns of the poses, and the tool ball in the robot base x_mm,y_mm,z_mm with sd_mm. That is
    /// the 3-D standard deviation (root of the mean square distance), with the repeatability of a pose, after the best
    /// rigid alignment over the poses (with fewer than 10, over the workspace too).
    #[arg(long, value_name = "P.csv")]
    out: PathBuf,
}

/// A pose with its ball.
#[derive(Serialize)]
struct Predicted {
    axes_deg: [f64; 6],
    approach: [i8; 6],
    ball_mm: [f64; 3],
    sd_mm: f64,
}

pub(super) fn run(args: &Args, out: &Output) -> Result<Outcome, Diagnostic> {
    files::keeps(&args.out, [args.axes.as_path(), Path::new(&args.robot)])?;
    files::is_earlier(&args.out, (header().join(",") + "\n").as_bytes())?;
    let robot = robots::named(&args.robot, out)?;
    let poses = out.table(&args.axes, Measurements::poses_from_table)?;
    let edited = robots::edited(&robot);
    edited.into_iter().for_each(|doubt| out.finding(Diagnostic::file(&args.robot, doubt)));
    let angles = poses.iter().zip(1..).map(|(pose, number)| (number, pose.axes));
    let beyond = measurement::beyond(angles, robot.controller());
    beyond
        .into_iter()
        .for_each(|doubt| out.finding(Diagnostic::file(&args.axes.display().to_string(), doubt)));
    let positions = Positions::of(&robot, &poses);
    let predicted: Vec<Predicted> = (0..poses.len())
        .map(|at| Predicted {
            axes_deg: poses[at].axes.degrees(),
            approach: poses[at].approach.senses(),
            ball_mm: positions.balls[at].into(),
            sd_mm: positions.sd_mm(at),
        })
        .collect();
    let table = csv(&predicted).map_err(|error| CliFinding::NoOutput { why: error.to_string() })?;
    files::write(&args.out, table)?;
    out.document(&predicted)?;
    say(out, &robot, &predicted, args);
    Ok(Outcome::Done)
}

fn header() -> Vec<String> {
    let angles = (1..=6).map(|axis| format!("a{axis}_deg"));
    let places = ["x_mm", "y_mm", "z_mm", "sd_mm"];
    angles.chain(APPROACH.into_iter().chain(places).map(str::to_owned)).collect()
}

fn csv(predicted: &[Predicted]) -> Result<Vec<u8>, Box<dyn Error>> {
    let mut table = csv::Writer::from_writer(Vec::new());
    table.write_record(header())?;
    for row in predicted {
        table.serialize((row.axes_deg, row.approach, row.ball_mm, row.sd_mm))?;
    }
    Ok(table.into_inner()?)
}

fn say(out: &Output, robot: &Robot, predicted: &[Predicted], args: &Args) {
    let mean = predicted.iter().map(|row| row.sd_mm).sum::<f64>() / predicted.len() as f64;
    let largest = predicted.iter().map(|row| row.sd_mm).fold(0.0, f64::max);
    out.result(format!(
        "{}: {} poses, 3-D standard deviation of the tool ball {mean:.3} mm in the mean, at most {largest:.3} mm; {}",
        robot.name,
        predicted.len(),
        args.out.display()
    ));
}
