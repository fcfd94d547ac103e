//! `dbbd circle`.

use std::path::{Path, PathBuf};

use super::{CommandOutput, value};
use dbbd_job::report::circle::CircleTest;
use dbbd_job::request::Request;
use dbbd_job::request::circle::{CircleDocument, CircleRequest, DEFAULT_DRAWS};
use dbbd_model::circular::{CircularEvaluation, QUANTITY_NAMES};

/// Evaluate circular tests according to ISO 230-4.
///
/// Computes G, G(b), D, F and H, each with a 95 % interval, and the reversal error of each axis or joint.
/// docs/reference/circular-test.md says which parts of the standard could not be consulted.
#[derive(clap::Args)]
pub(crate) struct CircleArgs {
    /// Captures that contain a plan, or CSV files run,direction,angle_deg,length_mm[,t_s,temp_c] (direction cw or ccw;
    /// length between ball centres). Several inputs are shown as a trend, in this order.
    #[arg(required = true, value_name = "RUN|CSV")]
    inputs: Vec<PathBuf>,
    /// Directory for circle.json, circle.html and the polar plots as SVG.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Nominal radius, mm [default: the plan's; of a CSV the mean length, rounded to a millimetre].
    #[arg(long, value_name = "MM", value_parser = value::positive)]
    radius: Option<f64>,
    /// The plan that the robot executed, with its .json beside it [default: the one in the capture].
    #[arg(long, value_name = "PLAN.csv")]
    plan: Option<PathBuf>,
    /// The .dat of a module, fetched from the controller after the run: the axis angles that the program logged show where
    /// joints reverse. Give it once for each module.
    #[arg(long, value_name = "FILE.dat")]
    axes: Vec<PathBuf>,
    /// Standard uncertainty of a single length, mm [default: that of the dwells; of a CSV the scatter].
    #[arg(long, value_name = "MM", value_parser = value::length_sd)]
    sigma: Option<f64>,
    /// Standard uncertainty (k = 1) of the bar's length by its certificate, mm; it contributes to D and F [default: half of
    /// length_u_mm in the job of a capture].
    #[arg(long, value_name = "MM", value_parser = value::bar_u)]
    bar_u: Option<f64>,
    /// Thermal expansion of the bar, 1/K [default: of a capture, that in its job]. With temperatures (in a capture, or in the
    /// column temp_c) a length is corrected from the certificate's temperature to that of the bar.
    #[arg(long, value_name = "PER_K", value_parser = value::expansion)]
    expansion: Option<f64>,
    /// Temperature of the bar's certificate, degrees Celsius [default: of a capture, that in its job; else 20].
    #[arg(long, value_name = "C", value_parser = value::certified, allow_negative_numbers = true)]
    certified: Option<f64>,
    /// Thermal expansion of the machine, 1/K. With temperatures, its circle is referred to 20 degrees Celsius.
    #[arg(long, value_name = "PER_K", value_parser = value::expansion)]
    machine_expansion: Option<f64>,
    /// Number of Monte Carlo draws for the 95 % intervals: 0 for none, else 50 to 1000000.
    #[arg(long, value_name = "N", default_value_t = DEFAULT_DRAWS, value_parser = value::draws)]
    monte_carlo: usize,
    /// Replace an earlier result in DIR [default: its files move to DIR/previous-1, DIR/previous-2 and so on].
    #[arg(long)]
    replace: bool,
}

/// What the arguments ask for.
pub(super) fn request(args: &CircleArgs) -> Request {
    Request::Circle(CircleRequest {
        inputs: args.inputs.clone(),
        out: args.out.clone(),
        radius_mm: args.radius,
        plan: args.plan.clone(),
        axes: args.axes.clone(),
        sigma_mm: args.sigma,
        bar_u_mm: args.bar_u,
        expansion_per_k: args.expansion,
        certified_c: args.certified,
        machine_expansion_per_k: args.machine_expansion,
        monte_carlo: args.monte_carlo,
        replace: args.replace,
    })
}

pub(super) fn show(out: &CommandOutput, document: &CircleDocument, directory: &Path) {
    document.tests.iter().for_each(|test| show_circular_test(test, out));
    out.result(format!("results in {}", directory.display()));
}

fn show_circular_test(test: &CircleTest, out: &CommandOutput) {
    let CircularEvaluation { radius_mm, arc, traces, .. } = &test.evaluation;
    let points: usize = traces.iter().map(|trace| trace.points).sum();
    out.result(format!(
        "{}: radius {radius_mm} mm, {points} points, {:.0} degrees, condition {:.1}",
        test.source, arc.span_deg, arc.condition
    ));
    for (name, quantity) in QUANTITY_NAMES.iter().zip(&test.evaluation.quantities) {
        if let Some(value) = quantity.value {
            let u95 = quantity.u95.map_or(String::new(), |u| format!(" +- {u:.5}"));
            out.result(format!("  {name:6} {value:10.5}{u95} mm"));
        }
    }
}
