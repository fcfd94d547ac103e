//! The identity of robot and bar, as stated by an earlier result and a file of the user.

use std::path::Path;

use dbbd_device::clock;
use dbbd_model::base::FileFinding;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::provenance::ProvenanceFinding::{self, OtherThanPlanned, SerialOfNoBall};
use dbbd_model::provenance::{Contradiction, Identity, Provenance};
use serde::Deserialize;

use crate::files;

/// Reads the identity of a measurement from a TOML file.
pub fn read_identity(path: &Path) -> Result<Identity, Diagnostic> {
    let file = path.display().to_string();
    let identity = Identity::from_toml(&file, &files::read_definition(path)?)?;
    identity.check_dates(clock::unix_ns()).map_err(|(_, finding)| finding.in_file(&file))?;
    Ok(identity)
}

/// Contradictions in `stated` that cannot be true of a run of this job with this number of base balls: another robot,
/// bar, certificate or bar temperature than the lengths were computed with, or the serial number of a further ball.
/// Other facts may be known better after the run.
pub fn other_run(job: &Identity, balls: usize, stated: &Identity) -> Vec<ProvenanceFinding> {
    let is_fixed = |key: &str| key == "robot" || key.starts_with("bar.") || key == "celsius of bar";
    let other = job.contradictions(stated).into_iter().filter(|other| is_fixed(&other.key));
    let other =
        other.map(|Contradiction { key, known, stated }| OtherThanPlanned { key, planned: known, stated });
    let is_further = |ball: &&String| ball.parse::<usize>().is_ok_and(|number| number > balls);
    let further = stated.balls.keys().filter(is_further);
    other.chain(further.map(|ball| SerialOfNoBall { ball: ball.clone(), balls })).collect()
}

/// An earlier result that a new result replaces.
#[derive(Default, Deserialize)]
pub(super) struct EarlierResult {
    #[serde(default)]
    robot: Option<String>,
    #[serde(default)]
    pub(super) provenance: Provenance,
}

impl EarlierResult {
    /// Reads an earlier result; empty if there is no readable result.
    pub(super) fn read(file: &Path) -> Self {
        let text = files::read_if_file(file).and_then(Result::ok);
        text.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default()
    }
}

/// Refuses to replace the result of another robot, by the serial numbers if both are known, else by the names.
pub(super) fn check_replaced(
    file: &Path,
    robot: Option<&str>,
    provenance: &Provenance,
) -> Result<(), Diagnostic> {
    let earlier = EarlierResult::read(file);
    let differ =
        |(known, new): &(Option<&str>, Option<&str>)| known.is_some() && new.is_some() && known != new;
    let serials = (earlier.provenance.identity.robot.as_deref(), provenance.identity.robot.as_deref());
    let earlier_name = earlier.robot.or_else(|| earlier.provenance.robot().map(|robot| robot.name.clone()));
    let names = (earlier_name.as_deref(), robot);
    match [serials, names].iter().find(|pair| differ(pair)) {
        Some((Some(known), _)) => {
            let finding = FileFinding::OtherRobot { robot: (*known).into() };
            Err(Diagnostic::file(file.display(), finding))
        }
        _ => Ok(()),
    }
}
