//! `dbbd predict`.

use std::path::{Path, PathBuf};

use nalgebra::{Matrix3, Vector3};
use serde::Serialize;

use super::{CommandOutcome, CommandOutput, robots, value};
use dbbd_device::clock;
use dbbd_job::files;
use dbbd_job::request;
use dbbd_job::robot_files::RobotName;
use dbbd_model::base::date::utc;
use dbbd_model::base::serialised;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::{Orientations, Positions};
use dbbd_model::measurement::{self, APPROACH, ApproachedPose, Measurements};
use dbbd_model::provenance::ArtefactRole;
use dbbd_model::robot::{LoadedRobot, MeasurementConditions};

/// Predict the position of the tool ball at axis angles, with its uncertainty.
///
/// Use it to compare an identified robot with a tracker. Backlash is applied if the sense of approach is given; if it is
/// unknown, its variance is added. So is the variance of a joint's smooth error at angles that were not measured.
#[derive(clap::Args)]
pub(crate) struct PredictArgs {
    /// Poses: CSV a1_deg,..,a6_deg[,approach1,..,approach6] with the controller's axis angles, and the direction of the last
    /// move of each axis (1: rising angle, -1: falling angle, 0 or absent: unknown).
    axes: PathBuf,
    /// Robot: a built-in name or a TOML file, such as robot-identified.toml.
    #[arg(long, value_name = "NAME|FILE|DIR")]
    robot: RobotName,
    /// Predict this point in place of the tool ball: mm in the flange frame, where it is known exactly.
    #[arg(long, value_name = "X,Y,Z[,A,B,C]", value_parser = value::tool, allow_hyphen_values = true)]
    tool: Option<[f64; 3]>,
    /// What the flange carries: the name of a [[payload]] of the robot file, or its mass in kg and its centre in the flange
    /// frame in mm [default: the first of the robot file].
    #[arg(long, value_name = "NAME|KG,X,Y,Z", allow_hyphen_values = true)]
    payload: Option<String>,
    /// Predict by lengths and angles alone, as a program that reads robot-identified.toml or a URDF: without compliance and errors of
    /// the joints, whose displacement is added to sd_mm.
    #[arg(long, value_name = "MODEL", value_parser = ["geometric"])]
    model: Option<String>,
    /// The day of the prediction, YYYY-MM-DD [default: today]: what is known of the robot fades with the months since its
    /// measurement.
    #[arg(long, value_name = "DATE", value_parser = value::date)]
    date: Option<String>,
    /// Mean temperature then, degrees Celsius [default: not known]: if that of the measurement is known too, the links have
    /// grown by the difference; otherwise the season widens the prediction.
    #[arg(long, value_name = "CELSIUS", value_parser = value::temperature, allow_hyphen_values = true)]
    temperature: Option<f64>,
    /// Table to write: the columns of the poses, the position of the tool ball in the robot base x_mm,y_mm,z_mm, and sd_mm,
    /// its 3-D standard deviation (root of the mean square distance). This includes the repeatability of a pose, and is
    /// taken after the best rigid alignment over the poses (of fewer than 10, over the workspace too). sd_mrad is the
    /// standard deviation of the orientation of the flange; the turn that all poses have in common is taken out. cxx,cxy,cxz,cyy,cyz,czz
    /// are the covariance of the position in the robot base, mm^2, whose trace is the square of sd_mm; 95 % of the errors e
    /// have e' C^-1 e / 3 <= F(0.95; 3, nu) with this covariance C; nu is inf for normal errors of known covariance.
    #[arg(long, value_name = "P.csv")]
    out: PathBuf,
}

#[derive(Serialize)]
struct PredictedBall {
    axes_deg: [f64; 6],
    approach: [i8; 6],
    ball_mm: [f64; 3],
    sd_mm: f64,
    sd_mrad: f64,
    /// Upper triangle of the covariance of the position, row by row.
    covariance_mm2: [f64; 6],
    /// Degrees of freedom of the 95 % region; `None` for a normal error of known covariance.
    degrees_of_freedom: Option<f64>,
}

impl PredictedBall {
    /// The position as it is written, with the covariance about it. A displacement that the written position leaves out adds its square.
    fn of(
        pose: &ApproachedPose,
        written: Vector3<f64>,
        (positions, at): (&Positions, usize),
        sd_mrad: f64,
        degrees_of_freedom: Option<f64>,
    ) -> Self {
        let off = written - positions.balls[at];
        let covariance = positions.covariance(at) + off * off.transpose();
        Self {
            axes_deg: pose.axes.degrees(),
            approach: pose.approach.senses(),
            ball_mm: written.into(),
            sd_mm: covariance.trace().sqrt(),
            sd_mrad,
            covariance_mm2: upper_triangle(&covariance),
            degrees_of_freedom,
        }
    }

    /// The columns after the position.
    fn uncertainties(&self) -> [f64; 9] {
        let [xx, xy, xz, yy, yz, zz] = self.covariance_mm2;
        let nu = self.degrees_of_freedom.unwrap_or(f64::INFINITY);
        [self.sd_mm, self.sd_mrad, xx, xy, xz, yy, yz, zz, nu]
    }
}

fn upper_triangle(symmetric: &Matrix3<f64>) -> [f64; 6] {
    [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)].map(|at| symmetric[at])
}

pub(super) fn run(args: &PredictArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    files::keeps(&args.out, [args.axes.as_path(), Path::new(&*args.robot)])?;
    files::is_earlier(&args.out, (columns().join(",") + "\n").as_bytes())?;
    let LoadedRobot { mut robot, source, .. } = robots::read_named_robot(&args.robot, out)?;
    let date = args.date.clone().unwrap_or_else(|| utc(clock::unix_ns()));
    out.findings_in(&*args.robot, robot.far_day(&date));
    robot = robot.under(&MeasurementConditions { date: Some(date), temperature_c: args.temperature });
    out.findings_in(&*args.robot, request::carrying(&args.robot, &mut robot, args.payload.as_deref())?);
    let (table, changed) = dbbd_job::artefact::of_table(ArtefactRole::Measurements, &args.axes)?;
    out.findings(changed);
    table.check_made_for(&source.artefact)?;
    let poses = out.table(&args.axes, Measurements::poses_from_table)?;
    out.findings_in(&*args.robot, request::edited(&robot));
    let angles = poses.iter().zip(1..).map(|(pose, number)| (number, pose.axes));
    out.findings_in(args.axes.display(), measurement::beyond(angles, robot.controller()));
    let orientations = Orientations::of(&robot, &poses);
    if let Some(tool) = args.tool {
        robot = robot.with_exact_tool(tool);
    }
    robot.check_tool().map_err(|why| Diagnostic::file(&*args.robot, why))?;
    let positions = Positions::of(&robot, &poses);
    let table = args.model.is_some().then(|| robot.geometry.rigid());
    let ball = |at: usize| match &table {
        Some(table) => table.ball(&poses[at].axes.radians()).position,
        None => positions.balls[at],
    };
    let freedom = robot.known_uncertainty().region_degrees_of_freedom();
    let row = |(at, pose): (usize, &ApproachedPose)| {
        PredictedBall::of(pose, ball(at), (&positions, at), 1e3 * orientations.sd_rad(at), freedom)
    };
    let predicted: Vec<PredictedBall> = poses.iter().enumerate().map(row).collect();
    let rows = predicted.iter().map(|row| (row.axes_deg, row.approach, row.ball_mm, row.uncertainties()));
    files::write_file(&args.out, serialised::csv_table(columns(), rows)?)?;
    out.document(&predicted)?;
    let mean = predicted.iter().map(|row| row.sd_mm).sum::<f64>() / predicted.len() as f64;
    let largest = predicted.iter().map(|row| row.sd_mm).fold(0.0, f64::max);
    out.result(format!(
        "{}: {} poses, 3-D standard deviation of the tool ball {mean:.3} mm in the mean, at most {largest:.3} mm; {}",
        robot.name,
        predicted.len(),
        args.out.display()
    ));
    Ok(CommandOutcome::Done)
}

fn columns() -> Vec<String> {
    let angles = (1..=6).map(|axis| format!("a{axis}_deg"));
    let places = ["x_mm", "y_mm", "z_mm", "sd_mm", "sd_mrad", "cxx", "cxy", "cxz", "cyy", "cyz", "czz", "nu"];
    angles.chain(APPROACH.into_iter().chain(places).map(str::to_owned)).collect()
}
