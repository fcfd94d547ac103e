//! The tables that an identification reads: measurements, priors.

use std::collections::BTreeMap;
use std::path::Path;

use crate::request::RequestSession;
use dbbd_model::base::table::TableReader;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::EstimationFinding;
use dbbd_model::measurement::MeasurementFinding;
use dbbd_model::measurement::positions::PLACE;
use dbbd_model::measurement::{DistinctMeasurements, Measurements};
use dbbd_model::plausibility::{PlausibilityFinding, Quantity};
use dbbd_model::robot::RobotFinding;
use dbbd_model::robot::parameter::SetUpCounts;
use dbbd_model::robot::{ParamId, ParamUnit};

/// Reads a prior from a table with the columns name,unit,sd, such as the parameters.csv of an earlier identification.
pub(super) fn read_prior(
    table: &mut TableReader<'_>,
    set_up: SetUpCounts,
) -> Result<BTreeMap<ParamId, f64>, Diagnostic> {
    let [name, unit, sd] = table.required(["name", "unit", "sd"])?;
    let mut prior = BTreeMap::new();
    while let Some(row) = table.row()? {
        let Some(value) = row.given(Some(sd), |at| row.positive(at))? else {
            continue;
        };
        let id: ParamId = row.text(name).parse().map_err(|why: RobotFinding| row.wrong(name, why))?;
        set_up.check(id).map_err(|why| row.wrong(name, why))?;
        if row.text(unit) != id.unit().name() {
            let (parameter, given) = (id.to_string(), row.text(unit).into());
            let wrong = EstimationFinding::OtherUnitThan { parameter, unit: id.unit().to_string(), given };
            return Err(row.wrong(unit, wrong));
        }
        plausible_deviation(id, value).map_err(|why| row.wrong(sd, why))?;
        if prior.insert(id, value).is_some() {
            let parameter = id.to_string();
            return Err(row.wrong(name, EstimationFinding::ParameterTwice { parameter }));
        }
    }
    Ok(prior)
}

/// Refuses a prior standard deviation (mm, rad) that no parameter of a geometry has.
pub fn plausible_deviation(id: ParamId, sd: f64) -> Result<(), PlausibilityFinding> {
    let is_angle = id.unit() == ParamUnit::Rad;
    let quantity = if is_angle { Quantity::PriorAngleSd } else { Quantity::PriorLengthSd };
    if id.is_geometric() { quantity.check(id.to_string(), sd) } else { Ok(()) }
}

/// Reads a table of measurements with `read`. Reports rows that occur twice, and uses them once.
pub(crate) fn measurements(
    path: &Path,
    read: impl FnOnce(&mut TableReader<'_>) -> Result<Measurements, Diagnostic>,
    findings: &mut Vec<Diagnostic>,
    session: &RequestSession<'_>,
) -> Result<Measurements, Diagnostic> {
    let table = session.table(path, read)?;
    let rows = table.count();
    let DistinctMeasurements { measurements, repeated } =
        table.distinct().map_err(|finding| Diagnostic::file(path.display(), finding))?;
    if repeated > 0 {
        findings.push(Diagnostic::file(path.display(), MeasurementFinding::Repeated { repeated, rows }));
    }
    Ok(measurements)
}

/// Whether a table is a `plan.csv`: no table of measured lengths has these columns.
fn is_plan(table: &TableReader<'_>) -> bool {
    ["move", "dwell_s"].into_iter().all(|column| has(table, column))
}

fn has(table: &TableReader<'_>, column: &str) -> bool {
    table.names().iter().any(|name| name == column)
}

/// Reads the lengths of a table.
pub(crate) fn lengths(table: &mut TableReader<'_>) -> Result<Measurements, Diagnostic> {
    if is_plan(table) {
        return Err(Diagnostic::file(table.file(), MeasurementFinding::IsPlan));
    }
    Measurements::from_table(table)
}

/// Reads the lengths or the positions of a table, whichever it has.
pub(super) fn lengths_or_positions(table: &mut TableReader<'_>) -> Result<Measurements, Diagnostic> {
    if PLACE.into_iter().all(|column| has(table, column)) && !has(table, "length_mm") && !is_plan(table) {
        return Measurements::positions_from_table(table);
    }
    lengths(table)
}
