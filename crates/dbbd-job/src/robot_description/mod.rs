//! A robot from a description that is not a robot file: a URDF, the machine data of a controller, or its factory calibration.
//!
//! This module reads joint axes as lines in space, and makes a table of them. It does not know what is measured with
//! the robot.

mod arm_lines;
mod catalogue;
mod controller;
mod machine_data;
pub(crate) mod universal;
pub(crate) mod urdf;

pub use arm_lines::{CHECKED_POSES, ImportedRobot};
pub use catalogue::DescriptionFinding;
pub use controller::{Coupled, KnownOfRobot, PendantPose};
pub use machine_data::{MachineData, WristLink};
pub use universal::FactoryTable;

use dbbd_model::diagnostic::Diagnostic;

/// What describes the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DescriptionKind {
    Urdf,
    MachineData,
    FactoryCalibration,
}

impl DescriptionKind {
    /// The kind of a text. A text that is neither of the others is read as a factory calibration.
    pub fn of(text: &str) -> Self {
        if text.trim_start().starts_with('<') {
            Self::Urdf
        } else if MachineData::is_in(text) {
            Self::MachineData
        } else {
            Self::FactoryCalibration
        }
    }
}

/// A robot as its controller knows it, from the text of a URDF, of a `$machine.dat`, or of the factory calibration of a controller.
///
/// # Errors
/// The text is none of these, or does not describe an arm of six rotary joints in a chain; or the controller shows another pose.
pub fn import(file: &str, text: &str, known: KnownOfRobot<'_>) -> Result<ImportedRobot, Diagnostic> {
    let in_file = |finding: DescriptionFinding| Diagnostic::file(file, finding);
    let imported = match DescriptionKind::of(text) {
        DescriptionKind::Urdf => urdf::import(file, text, known)?,
        DescriptionKind::MachineData => machine_data::import(text).map_err(in_file)?,
        DescriptionKind::FactoryCalibration => {
            let table = FactoryTable::read(text).map_err(in_file)?;
            let like = known.like.ok_or_else(|| in_file(DescriptionFinding::TypeNeeded))?;
            table.imported(like).map_err(in_file)?
        }
    };
    match known.shown {
        Some(shown) => shown.proved(imported).map_err(in_file),
        None => Ok(imported),
    }
}
