//! Reads the robot that the user names, by its built-in name or file, and the result and the checks beside it.
//!
//! This module knows where these files are. It knows neither what is measured with the robot nor what is computed from
//! the result.

use std::fs;
use std::ops::Deref;
use std::path::{Path, PathBuf};

use dbbd_device::clock;
use dbbd_model::base::date;
use dbbd_model::conformity::{Standing, StatedCheck, StatedResult, standing};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::CalibrationResult;
use dbbd_model::provenance::{ArtefactRole, Provenance};
use dbbd_model::robot::{LoadedRobot, Robot};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::artefact::read_as;
use crate::files;

/// The name of the file of an identified robot in the directory of its result.
pub const ROBOT: &str = "robot-identified.toml";

/// A robot as a user names it: by the name of a built-in robot, by its file, or by the directory of a result. The directory is
/// replaced by the file of the identified robot in it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "String", into = "String")]
pub struct RobotName(String);

impl From<String> for RobotName {
    fn from(name: String) -> Self {
        let is_directory = Robot::built_in_file(&name).is_none() && Path::new(&name).is_dir();
        let file = is_directory.then(|| Path::new(&name).join(ROBOT).display().to_string());
        Self(file.unwrap_or(name))
    }
}

impl From<&str> for RobotName {
    fn from(name: &str) -> Self {
        name.to_owned().into()
    }
}

impl From<RobotName> for String {
    fn from(RobotName(name): RobotName) -> Self {
        name
    }
}

/// The built-in name, or the path of the file.
impl Deref for RobotName {
    type Target = str;

    fn deref(&self) -> &str {
        &self.0
    }
}

impl RobotName {
    /// The robot's file; `None` of a built-in robot.
    pub fn file(&self) -> Option<&Path> {
        Robot::built_in_file(self).is_none().then_some(Path::new(&self.0))
    }

    /// Reads the robot. A name with the ending `.toml` must be a file.
    ///
    /// # Errors
    /// There is no such robot and no such file, or the file is not a robot.
    pub fn read(&self) -> Result<LoadedRobot, Diagnostic> {
        match Robot::built_in_file(self) {
            Some(text) => LoadedRobot::from_toml(self, text),
            None => {
                let path = Path::new(&self.0);
                let text = files::if_there(path, ".toml").ok_or_else(|| Robot::unknown(self))??;
                read_as(path, ArtefactRole::Robot, LoadedRobot::from_toml(self, &text))
            }
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

/// The robot in the file beside a result, with what is not known of it. `None` without a file, or if it is of another
/// calibration than one that was made from the same sources as the result.
///
/// # Errors
/// The file is not a robot.
pub fn robot_of_result(result: &Path, made_from: &Provenance) -> Result<Option<LoadedRobot>, Diagnostic> {
    let file = result.with_file_name(ROBOT);
    if !files::is_there(&file) {
        return Ok(None);
    }
    let read = RobotName::from(file.display().to_string()).read()?;
    let is_own = read.robot.has_posterior() && read.robot.provenance.from == made_from.from;
    Ok(is_own.then_some(read))
}

/// The file of a check.
const CHECK: &str = "check.json";
/// A check.json with the largest number of hypotheses is smaller.
const MAX_CHECK_BYTES: u64 = 16 << 20;

/// The standing today of the calibration in a robot file, by the result and the checks beside it. `None` if its result is
/// not beside it and it has no check.
pub fn standing_of(file: &Path, robot: &Robot) -> Result<Option<Standing>, Diagnostic> {
    let check = last_check(file)?.map(|(_, check)| check);
    let result = match result_beside(file, robot) {
        Ok((_, ResultBeside::Own(result))) => StatedResult::from(&*result),
        // A result that was edited states nothing.
        Ok((_, ResultBeside::Another | ResultBeside::Nothing)) | Err(_) if check.is_some() => {
            StatedResult::default()
        }
        Ok((_, ResultBeside::Another | ResultBeside::Nothing)) | Err(_) => return Ok(None),
    };
    Ok(Some(standing(&result, check.as_ref(), Some(&date::utc(clock::unix_ns())))))
}

/// The newest check of a robot file in the [`files::directories_around`] it.
pub fn last_check(robot_file: &Path) -> Result<Option<(PathBuf, StatedCheck)>, Diagnostic> {
    if !robot_file.is_file() {
        return Ok(None);
    }
    let sha256 = files::sha256(robot_file)?;
    let found = files::directories_around(robot_file).into_iter().filter_map(|directory| {
        let path = directory.join(CHECK);
        let changed = fs::metadata(&path).and_then(|data| data.modified()).ok()?;
        let text = files::read_at_most(&path, MAX_CHECK_BYTES).ok()?;
        let check: StatedCheck = serde_json::from_str(&text).ok()?;
        check.is_of(&sha256).then_some((changed, path, check))
    });
    Ok(found.max_by_key(|(changed, ..)| *changed).map(|(_, path, check)| (path, check)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use dbbd_model::conformity::ConformityOutcome;

    #[test]
    fn a_robot_is_named_by_built_in_name_file_or_directory_of_its_result() {
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join(ROBOT);
        let named = |path: &Path| RobotName::from(path.display().to_string());
        assert_eq!(named(directory.path()).file(), Some(file.as_path()));
        // Without a robot in it the file is missing, not the directory.
        assert_eq!(named(directory.path()).read().err().unwrap().code().as_str(), "E0101");
        fs::write(&file, Robot::built_in_file("kr60ha").unwrap()).unwrap();
        assert_eq!(named(directory.path()), named(&file));
        let built_in = RobotName::from("kr60ha");
        assert_eq!((built_in.file(), &*built_in), (None, "kr60ha"));
        let robots = [named(&file), built_in].map(|name| name.read().unwrap().robot);
        assert_eq!(robots[0], robots[1]);
        let json = serde_json::to_string(directory.path()).unwrap();
        assert_eq!(serde_json::from_str::<RobotName>(&json).unwrap(), named(&file));
    }

    #[test]
    fn the_newest_check_of_the_same_robot_file_counts() {
        let directory = tempfile::tempdir().unwrap();
        let at = |name: &str| directory.path().join(name);
        fs::create_dir(at("result")).unwrap();
        let robot = at("result").join("robot-identified.toml");
        fs::write(&robot, "robot").unwrap();
        assert_eq!(last_check(&robot).unwrap(), None);
        let sha256 = files::sha256(&robot).unwrap();
        let write = |name: &str, decision: &str, sha256: &str| {
            fs::create_dir(at(name)).unwrap();
            let from = json!([{ "role": "identified_robot", "name": "r", "sha256": sha256 }]);
            let check = json!({ "decision": decision, "provenance": { "from": from } });
            fs::write(at(name).join(CHECK), check.to_string()).unwrap();
        };
        write("a", "pass", &sha256);
        clock::sleep(0.02);
        write("b", "fail", &sha256);
        clock::sleep(0.02);
        write("c", "pass", "of another");
        let (path, found) = last_check(&robot).unwrap().unwrap();
        // The robot file in the directory above, where a user works.
        let above = at("robot-identified.toml");
        fs::copy(&robot, &above).unwrap();
        assert_eq!(last_check(&above).unwrap().unwrap().0, path);
        assert_eq!(
            (path.parent().unwrap().file_name().unwrap().to_str(), found.decision()),
            (Some("b"), ConformityOutcome::Fail)
        );
    }
}
