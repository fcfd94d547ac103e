//! Reads the robot that the user names, by its built-in name or file, and the result beside it.
//!
//! This module knows where these files are. It knows neither what is measured with the robot nor what is computed from
//! the result.

use std::path::{Path, PathBuf};

use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::CalibrationResult;
use dbbd_model::robot::{LoadedRobot, Robot};
use serde_json::{Value, json};

use crate::files;

/// The robot with a built-in name, or in a file. A name with the ending `.toml` must be a file.
///
/// # Errors
/// There is no such robot and no such file, or the file is not a robot.
pub fn named_robot(name: &str) -> Result<LoadedRobot, Diagnostic> {
    match Robot::built_in_file(name) {
        Some(text) => LoadedRobot::from_toml(name, text),
        None => {
            let text = files::if_there(Path::new(name), ".toml").ok_or_else(|| Robot::unknown(name))??;
            LoadedRobot::from_toml(name, &text)
        }
    }
}

/// The `result.json` beside a robot file.
#[derive(Clone, Debug, PartialEq)]
pub enum ResultBeside {
    /// A result of the same calibration.
    Own(Box<CalibrationResult>),
    /// A result of another robot or calibration.
    Another,
    Nothing,
}

/// The result file beside the file of `robot`, and its path.
///
/// # Errors
/// The file cannot be read, or is not a result.
pub fn result_beside(robot_file: &Path, robot: &Robot) -> Result<(PathBuf, ResultBeside), Diagnostic> {
    let path = robot_file.with_file_name("result.json");
    let Some(text) = files::read_if_file(&path).transpose()? else {
        return Ok((path, ResultBeside::Nothing));
    };
    let result = CalibrationResult::from_json(&path.display().to_string(), &text)?;
    let document: Option<Value> = serde_json::from_str(&text).ok();
    let chain = document.and_then(|document| document.get("provenance")?.get("from").cloned());
    let known = &robot.provenance.from;
    let is_other = !known.is_empty() && chain.is_some_and(|chain| chain != json!(known));
    let is_own = result.robot == robot.name && !is_other;
    Ok((path, if is_own { ResultBeside::Own(Box::new(result)) } else { ResultBeside::Another }))
}
