//! The true robot of the demo, and its comparison with the identified one.

use std::path::Path;

use nalgebra::Vector3;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use serde::Serialize;

use super::{PAPER, SimulatedDemo, TrueErrors};
use dbbd_job::files;
use dbbd_job::plan::Job;
use dbbd_job::robot_files::RobotName;
use dbbd_job::sim::truth;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::CalibrationResult;
use dbbd_model::estimation::result::{ParameterResult, Residual, Status};
use dbbd_model::estimation::{Workspace, with_drawn_joint_errors};
use dbbd_model::math::aligned_distances;
use dbbd_model::measurement::{BaseBall, LengthModel};
use dbbd_model::robot::{Geometry, ParamId, ParamUnit, Robot, parameter};

/// The standard deviation of the true places of the base balls about the plan's, mm.
const CENTRE_MM: f64 = 0.5;
/// The number of poses over which the 3-D error is taken, as in the prediction.
const TRUTH_POSES: usize = 2000;
/// The seed of these poses.
const TRUTH_POSES_SEED: u64 = 1;

/// The true robot and base balls.
pub(super) struct Truth {
    /// The tool ball that the job states, mm.
    tool_mm: [f64; 3],
    robot: Robot,
    centres: Vec<BaseBall>,
}

#[derive(Debug, Serialize)]
pub(super) struct TruthComparison {
    parameters: Vec<ComparedParameter>,
    residual_before_mm: Residual,
    residual_after_mm: Residual,
    /// Mean and largest true 3-D error of the nominal robot after alignment, mm.
    nominal_error_mm: [f64; 2],
    /// The same of the identified robot.
    identified_error_mm: [f64; 2],
    /// Mean error of the identified robot by its result, mm.
    predicted_error_mm: f64,
}

#[derive(Debug, Serialize)]
struct ComparedParameter {
    name: ParamId,
    unit: ParamUnit,
    /// True deviation from nominal of the parameter and of those that depend on it linearly.
    true_correction: f64,
    correction: f64,
    sd: f64,
}

impl Truth {
    /// Draws the true robot, and the true places of the balls where no ball was taught: a ball that was taught is where the true
    /// tool ball was. Writes `truth.toml` and `world.toml`.
    pub(super) fn draw(dir: &Path, demo: &SimulatedDemo, seed: u64) -> Result<Self, Diagnostic> {
        let job = Job::from_toml("job.toml", demo.job)?;
        let mut nominal = RobotName::from(job.robot.as_str()).read()?.robot;
        job.tool.state_in(&mut nominal);
        let drawn = truth::draw_true_robot(&nominal, seed, 1.0);
        let robot = match demo.errors {
            TrueErrors::Joints => with_drawn_joint_errors(&drawn, seed),
            TrueErrors::Geometry => drawn,
            TrueErrors::Paper => of_paper(&nominal, &drawn)?,
        };
        let mut centres = job.balls();
        let mut random = Pcg64::seed_from_u64(seed);
        let mut world = truth::noise(&nominal, job.bar.sigma_um);
        for (centre, table) in centres.iter_mut().zip(&job.centres) {
            let place = match table.taught_deg {
                Some(axes_deg) => {
                    centre.position = robot.geometry.ball(&axes_deg.map(f64::to_radians)).position;
                    format!("taught_deg = {axes_deg:?}")
                }
                None => {
                    let is_exact = matches!(demo.errors, TrueErrors::Paper);
                    centre.position += Vector3::from_fn(|_, _| {
                        let z: f64 = StandardNormal.sample(&mut random);
                        if is_exact { 0.0 } else { z * CENTRE_MM }
                    });
                    let [x, y, z]: [f64; 3] = centre.position.into();
                    format!("xyz_mm = [{x}, {y}, {z}]")
                }
            };
            world.push_str(&format!("\n[[centre]]\nid = {}\n{place}\n", centre.id));
        }
        files::write_file(&dir.join("world.toml"), world)?;
        files::write_file(&dir.join("truth.toml"), robot.to_toml()?)?;
        Ok(Self { tool_mm: nominal.geometry.tool.into(), robot, centres })
    }

    pub(super) fn tool_mm(&self) -> [f64; 3] {
        self.tool_mm
    }

    pub(super) fn compare(
        &self,
        result: &CalibrationResult,
        identified: &Robot,
    ) -> Result<TruthComparison, Diagnostic> {
        let nominal = identified.nominal.as_deref().unwrap_or(identified);
        let model = LengthModel::new(self.robot.geometry.clone(), &self.centres);
        let poses = Workspace::uniform(nominal, TRUTH_POSES, TRUTH_POSES_SEED);
        let balls = |geometry: &Geometry| -> Vec<Vector3<f64>> {
            poses.iter().map(|axes| geometry.ball(axes).position).collect()
        };
        let truth = balls(&self.robot.geometry);
        let error = |geometry: &Geometry| {
            let distances = aligned_distances(&truth, &balls(geometry));
            let mean = distances.iter().sum::<f64>() / distances.len().max(1) as f64;
            [mean, distances.into_iter().fold(0.0, f64::max)]
        };
        Ok(TruthComparison {
            parameters: result
                .parameters
                .iter()
                .filter(|parameter| matches!(parameter.status, Status::Identified | Status::SupportedByPrior))
                .filter_map(|parameter| compared(parameter, result, &model))
                .collect(),
            residual_before_mm: result.residual_mm.before,
            residual_after_mm: result.residual_mm.after,
            nominal_error_mm: error(&nominal.geometry),
            identified_error_mm: error(&identified.geometry),
            predicted_error_mm: result.predicted_position_uncertainty_mm.identified.mean,
        })
    }
}

/// The nominal robot with the errors that a drawn one has in the paper's parameters.
fn of_paper(nominal: &Robot, drawn: &Robot) -> Result<Robot, Diagnostic> {
    let mut robot = drawn.clone();
    robot.geometry = nominal.geometry.clone();
    for id in parameter::parse_list(PAPER, &nominal.parallel_joints(), 1)? {
        if let (Some(value), Some(own)) = (drawn.geometry.value(id), robot.geometry.value_mut(id)) {
            *own = value;
        }
    }
    Ok(robot)
}

fn compared(
    parameter: &ParameterResult,
    result: &CalibrationResult,
    truth: &LengthModel,
) -> Option<ComparedParameter> {
    let deviation = |id: ParamId| Some(truth.value(id) - result.parameter(id)?.nominal);
    let true_correction = match result.combinations.iter().find(|group| group.kept == parameter.name) {
        Some(group) => group.members.iter().filter_map(|(id, share)| Some(share * deviation(*id)?)).sum(),
        None => deviation(parameter.name)?,
    };
    Some(ComparedParameter {
        name: parameter.name,
        unit: parameter.unit,
        true_correction,
        correction: parameter.correction,
        sd: parameter.sd?,
    })
}

impl TruthComparison {
    /// The comparison on the terminal.
    pub(super) fn lines(&self) -> Vec<String> {
        let mut lines = vec![
            String::new(),
            "True against identified corrections (of what each parameter represents):".into(),
            format!(
                "{:>12} {:>10} {:>10} {:>10} {:>8}",
                "parameter", "true", "identified", "difference", "sd"
            ),
        ];
        for row in self.parameters.iter().filter(|row| !matches!(row.name, ParamId::PayloadCompliance(_))) {
            let (factor, unit) = match row.unit {
                ParamUnit::Mm => (1.0, "mm"),
                ParamUnit::Rad => (1e3, "mrad"),
                ParamUnit::RadPerNm => (1e6, "urad/(N m)"),
            };
            lines.push(format!(
                "{:>12} {:>10.4} {:>10.4} {:>10.4} {:>8.4} {unit}",
                row.name.to_string(),
                row.true_correction * factor,
                row.correction * factor,
                (row.correction - row.true_correction) * factor,
                row.sd * factor
            ));
        }
        let [before, after] = [self.residual_before_mm.rms, self.residual_after_mm.rms].map(|rms| rms * 1e3);
        lines.push(String::new());
        lines.push(format!("Residual of the lengths: rms {before:.1} um before, {after:.1} um after"));
        let ([mean, max], [mean_after, max_after]) = (self.nominal_error_mm, self.identified_error_mm);
        lines.push(format!(
            "True 3-D error over the whole workspace: mean {mean:.3} mm (largest {max:.3}) before, {mean_after:.3} mm \
             ({max_after:.3}) after; the result predicted a mean of {:.3} mm",
            self.predicted_error_mm
        ));
        lines
    }
}
