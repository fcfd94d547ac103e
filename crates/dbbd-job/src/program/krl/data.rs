//! The constants in `.dat` files, and the data that dbbd and its programs write there.

use std::collections::{BTreeMap, HashMap};

use super::evaluate::{Fault, constant_target};
use super::syntax::{Data, DataItem, Expression, Part, Place};
use super::value::Value;
use crate::program::ProgramFinding;
use crate::program::{Setup, Target};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::AXES;

/// The file that holds a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Origin {
    Source,
    Data,
    /// `$config.dat`, which is never rewritten.
    Config,
}

/// The name of a variable, with the index of an element of an array.
type Key<'a> = (&'a str, Option<i64>);

/// A constant as it is written.
#[derive(Clone, Copy, Debug)]
pub(super) struct Constant<'a> {
    pub(super) value: &'a Expression,
    pub(super) origin: Origin,
}

/// Constants by name and index.
#[derive(Default)]
pub(super) struct Constants<'a>(HashMap<&'a str, BTreeMap<Option<i64>, Constant<'a>>>);

impl<'a> Constants<'a> {
    /// Adds the constants of a file; they replace known constants of the same name.
    pub(super) fn add(&mut self, items: &'a [DataItem], origin: Origin) {
        for item in items {
            match item {
                DataItem::Declaration(declaration) => {
                    for declared in declaration.variables() {
                        if let Some(value) = &declared.value {
                            self.insert((declared.name.as_str(), None), Constant { value, origin });
                        }
                    }
                }
                DataItem::Value { target, value } => {
                    if let Some(key) = key(target) {
                        self.insert(key, Constant { value, origin });
                    }
                }
            }
        }
    }

    pub(super) fn insert(&mut self, (name, index): Key<'a>, constant: Constant<'a>) {
        self.0.entry(name).or_default().insert(index, constant);
    }

    pub(super) fn get(&self, (name, index): Key<'_>) -> Option<Constant<'a>> {
        self.0.get(name)?.get(&index).copied()
    }

    /// The indices of the elements that have a value, in order.
    pub(super) fn elements(&self, name: &str) -> impl Iterator<Item = i64> {
        self.0.get(name).into_iter().flat_map(|values| values.keys().copied().flatten())
    }

    /// Whether a name is the name of a point or of an array of points in the program's own files.
    pub(super) fn has_point(&self, name: &str) -> bool {
        let mut values = self.0.get(name).into_iter().flat_map(BTreeMap::values);
        values.any(|constant| constant.origin != Origin::Config && constant_target(constant.value).is_ok())
    }

    fn value(&self, name: &str) -> Option<Value> {
        self.get((name, None))?.value.constant().ok()
    }
}

/// The key of a place whose index, if it has one, is a number.
pub(super) fn key(place: &Place) -> Option<Key<'_>> {
    match place.parts.as_slice() {
        [] => Some((place.name.as_str(), None)),
        [Part::Element(index)] => Some((place.name.as_str(), Some(index.index()?))),
        _ => None,
    }
}

impl Data {
    fn constants(&self) -> Constants<'_> {
        let mut constants = Constants::default();
        constants.add(&self.items, Origin::Data);
        constants
    }
}

/// The axis angles (degrees) that the program has logged in its `.dat`, by row of the plan.
pub fn logged_axes(data: &Data) -> Result<BTreeMap<u32, [f64; AXES]>, Diagnostic> {
    let constants = data.constants();
    let is_declared = |name: &str| {
        data.items.iter().any(|item| {
            matches!(item, DataItem::Declaration(declaration)
                if declaration.variables().iter().any(|declared| declared.name == name))
        })
    };
    if !(is_declared("DBBROW") && is_declared("XQ")) {
        return Err(Diagnostic::file(&data.file, ProgramFinding::NoLoggedAxes));
    }
    let mut axes_by_row = BTreeMap::new();
    for element in constants.elements("XQ") {
        let Some(logged) = constants.get(("XQ", Some(element))) else { continue };
        let wrong = |fault: Fault| data.as_text().wrong(&fault.span, fault.finding);
        let row = constants.get(("DBBROW", Some(element))).and_then(|row| row.value.index());
        let Some(row) = row.and_then(|row| u32::try_from(row).ok()) else {
            return Err(wrong(Fault::new(&logged.value.span, ProgramFinding::NoRowOfPlan { element })));
        };
        match constant_target(logged.value).map_err(wrong)? {
            Target::Axes(axes_deg) => _ = axes_by_row.insert(row, axes_deg),
            Target::Pose { .. } => {
                return Err(wrong(Fault::new(&logged.value.span, ProgramFinding::NotAxisAngles)));
            }
        }
    }
    Ok(axes_by_row)
}

/// The hash of the plan in a `.dat` of dbbd.
pub fn plan_hash(data: &Data) -> Option<String> {
    data.items.iter().find_map(|item| {
        let DataItem::Value { target, value } = item else { return None };
        match value.constant() {
            Ok(Value::Text(text)) if target.name == "DBBPLAN" => Some(text),
            _ => None,
        }
    })
}

/// `$ABS_ACCUR` as the program logged it in its `.dat`: whether the controller was in its absolute-accuracy mode.
pub fn absolute_accuracy(data: &Data) -> Option<bool> {
    data.constants().value("DBBABS")?.bool().ok()
}

/// The set-up that dbbd wrote into a `.dat`; `None` if it is missing or incomplete.
pub fn read_setup(data: &Data) -> Option<Setup> {
    let constants = data.constants();
    let number = |name: &str| constants.value(name)?.number().ok();
    let ball = u32::try_from(constants.value("DBBBALL")?.int().ok()?).ok()?;
    let centre = constant_target(constants.get(("DBBCEN", None))?.value).ok()?;
    let Target::Pose { xyz_mm: centre_mm, .. } = centre else { return None };
    let stroke_mm = [number("DBBLOW")?, number("DBBHIGH")?];
    Some(Setup { ball, centre_mm, length_mm: number("DBBLEN")?, stroke_mm })
}
