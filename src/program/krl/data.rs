//! What the `.dat` files hold before a program runs, and what dbbd wrote into them.

use std::collections::{BTreeMap, HashMap};

use super::evaluate::{Fault, constant_target};
use super::syntax::{Data, DataItem, DeclarationKind, Expression, Part, Place};
use super::value::Value;
use crate::catalogue::ProgramFinding;
use crate::diagnostic::Diagnostic;
use crate::program::{Setup, Target};
use crate::robot::AXES;

/// The file of a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Origin {
    Source,
    Data,
    /// `$config.dat`, which is never rewritten.
    Config,
}

/// A variable, or an element of an array.
pub(super) type Key<'a> = (&'a str, Option<i64>);

/// A value that is written.
#[derive(Clone, Copy, Debug)]
pub(super) struct Constant<'a> {
    pub(super) value: &'a Expression,
    pub(super) origin: Origin,
}

/// Values by name and index.
#[derive(Default)]
pub(super) struct Constants<'a>(HashMap<&'a str, BTreeMap<Option<i64>, Constant<'a>>>);

impl<'a> Constants<'a> {
    /// Those of a file; a name that has a value already gets the new one.
    pub(super) fn add(&mut self, items: &'a [DataItem], origin: Origin) {
        for item in items {
            match item {
                DataItem::Declaration(declaration) => {
                    let DeclarationKind::Variables { names, .. } = &declaration.kind else { continue };
                    for declared in names {
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

    /// The elements of an array that have a value, in order.
    pub(super) fn elements(&self, name: &str) -> impl Iterator<Item = i64> {
        self.0.get(name).into_iter().flat_map(|values| values.keys().copied().flatten())
    }

    /// Whether a name is that of a point, or of an array of points, in the program's own files.
    pub(super) fn has_point(&self, name: &str) -> bool {
        let mut values = self.0.get(name).into_iter().flat_map(BTreeMap::values);
        values.any(|constant| constant.origin != Origin::Config && constant_target(constant.value).is_ok())
    }

    fn value(&self, name: &str) -> Option<Value> {
        self.get((name, None))?.value.constant().ok()
    }
}

/// The variable or element that a place names, where its index is a number.
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

/// The axis angles (degrees) that the program logged into its `.dat`, by row of the plan.
pub fn logged_axes(data: &Data) -> Result<BTreeMap<u32, [f64; AXES]>, Diagnostic> {
    let constants = data.constants();
    let declared = |wanted: &str| {
        data.items.iter().any(|item| match item {
            DataItem::Declaration(declaration) => match &declaration.kind {
                DeclarationKind::Variables { names, .. } => names.iter().any(|name| name.name == wanted),
                _ => false,
            },
            DataItem::Value { .. } => false,
        })
    };
    if !(declared("DBBROW") && declared("XQ")) {
        return Err(Diagnostic::file(&data.file, ProgramFinding::NoLoggedAxes));
    }
    let mut found = BTreeMap::new();
    for element in constants.elements("XQ") {
        let Some(logged) = constants.get(("XQ", Some(element))) else { continue };
        let wrong = |fault: Fault| data.as_text().wrong(&fault.span, fault.finding);
        let row = constants.get(("DBBROW", Some(element))).and_then(|row| row.value.index());
        let Some(row) = row.and_then(|row| u32::try_from(row).ok()) else {
            return Err(wrong(Fault::new(&logged.value.span, ProgramFinding::NoRowOfPlan { element })));
        };
        match constant_target(logged.value).map_err(wrong)? {
            Target::Axes(axes_deg) => _ = found.insert(row, axes_deg),
            Target::Pose { .. } => {
                return Err(wrong(Fault::new(&logged.value.span, ProgramFinding::NotAxisAngles)));
            }
        }
    }
    Ok(found)
}

/// The hash of the plan that a `.dat` of dbbd names.
pub fn plan_hash(data: &Data) -> Option<String> {
    data.items.iter().find_map(|item| match item {
        DataItem::Value { target, value } if target.name == "DBBPLAN" => match value.constant() {
            Ok(Value::Text(text)) => Some(text),
            _ => None,
        },
        _ => None,
    })
}

/// `$ABS_ACCUR` when the program ran: whether the controller was in its absolute-accuracy mode, where the `.dat` has it.
pub fn absolute_accuracy(data: &Data) -> Option<bool> {
    data.constants().value("DBBABS")?.bool().ok()
}

/// The set-up that dbbd wrote into a `.dat`; `None` where it is not there, whole.
pub fn read_setup(data: &Data) -> Option<Setup> {
    let constants = data.constants();
    let number = |name: &str| constants.value(name)?.number().ok();
    let ball = u32::try_from(constants.value("DBBBALL")?.int().ok()?).ok()?;
    let centre = constant_target(constants.get(("DBBCEN", None))?.value).ok()?;
    let Target::Pose { xyz_mm: centre_mm, .. } = centre else { return None };
    let stroke_mm = [number("DBBLOW")?, number("DBBHIGH")?];
    Some(Setup { ball, centre_mm, length_mm: number("DBBLEN")?, stroke_mm })
}
