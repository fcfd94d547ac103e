//! The points of a RAPID module and their correction.

use std::collections::HashMap;

use super::instruction::Instruction;
use super::literal::{external, not_of_unit_length, predefined, taught};
use super::parser::{Module, parse};
use super::program::declared;
use crate::program::CompensationFinding;
use crate::program::MotionKind;
use crate::program::compensate::{Branch, Corrected, Corrector, external_motion};
use crate::program::script::expression::{Statement, StatementKind};
use crate::program::script::points::{OtherInstructions, Point, Points, elements, replaced};
use crate::program::script::value::evaluated;
use crate::program::text::{Edit, Text};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::Pose;

/// Fewest decimals of a length, an axis angle and a component of a quaternion.
const DECIMALS_MM: usize = 3;
const DECIMALS_DEG: usize = 5;
const DECIMALS_QUATERNION: usize = 8;

const OTHERS: OtherInstructions = OtherInstructions {
    motions: &["MOVE", "TRIGG", "SEARCH", "ARC", "SPOT", "PAINT", "DISP"],
    displacements: &["PDISPON", "PDISPSET", "EOFFSON", "EOFFSSET"],
    settings: &[],
};

/// The points of a module; `config` is a module with tools and work objects.
pub fn read(text: Text<'_>, config: Option<Text<'_>>) -> Result<Points, Diagnostic> {
    let module = parse(text, 0)?;
    let config = config.map(|config| parse(config, 1)).transpose()?;
    let statements = || module.routines.iter().flat_map(|routine| &routine.body);
    // The last line that assigns to a name.
    let assigned = statements().filter_map(|statement| {
        if let StatementKind::Assign { name, .. } | StatementKind::Other(name) = &statement.kind {
            Some((name.as_str(), text.line(statement.span.start)))
        } else {
            None
        }
    });
    let assigned_lines: HashMap<&str, usize> = assigned.collect();
    let mut reader =
        Reader { text, module: &module, config: config.as_ref(), assigned_lines, points: Points::new(write) };
    for statement in statements() {
        reader.statement(statement)?;
    }
    let mut points = reader.points.completed();
    let external = external_motion(points.points.iter().map(|point| {
        let name = point.value.name.as_deref().unwrap_or("inline");
        (name, external(&point.value))
    }));
    let external = external.map(|(at, finding)| text.wrong(&points.points[at].first_use, finding));
    points.doubts.extend(external);
    Ok(points)
}

struct Reader<'a> {
    text: Text<'a>,
    module: &'a Module,
    config: Option<&'a Module>,
    assigned_lines: HashMap<&'a str, usize>,
    points: Points,
}

impl Reader<'_> {
    fn statement(&mut self, Statement { span, kind }: &Statement) -> Result<(), Diagnostic> {
        let (text, module, config) = (self.text, self.module, self.config);
        let lookup = |name: &str| {
            let own = declared(module, name, 0);
            own.or_else(|| declared(config?, name, 1)).or_else(|| predefined(name))
        };
        let (name, arguments) = if let StatementKind::Call { name, arguments } = kind {
            (name.as_str(), evaluated(arguments, 0, &lookup))
        } else {
            ("", Vec::new())
        };
        let Some(instruction) = Instruction::new(name, &arguments) else {
            self.points.other(text, (span, kind), &arguments, &OTHERS, |value| taught(value).is_some());
            return Ok(());
        };
        // A local variable of the routine is not looked up: it counts as declared elsewhere.
        let assigned_line = |name: &str| lookup(name).and(self.assigned_lines.get(name).copied());
        if let Some(why) = instruction.computed(assigned_line) {
            return Err(text.wrong(span, why));
        }
        for argument in instruction.points() {
            if let Some(why) = argument.value.as_ref().and_then(not_of_unit_length) {
                return Err(text.wrong(span, why));
            }
            let taught = argument.value.as_ref().and_then(taught).map(|(target, configuration)| {
                let is_ptp = instruction.motion == MotionKind::Ptp;
                let branch = configuration.filter(|_| is_ptp).map_or(Branch::Nearest, Branch::ByQuadrants);
                (target, branch)
            });
            let frames = || instruction.frames().map_err(|why| text.wrong(span, why));
            self.points.add(text, span, argument, taught, frames)?;
        }
        Ok(())
    }
}

fn write(
    corrector: &Corrector,
    point: &Point,
    corrected: &Corrected,
    text: Text<'_>,
) -> Result<Vec<Edit>, CompensationFinding> {
    let Some(frames) = &point.frames else {
        let [axes, _] = elements(&point.value)?;
        return Ok(replaced(axes, &corrected.numbers, text, DECIMALS_DEG)?.0);
    };
    let pose = Pose::from_xyzabc(corrected.numbers);
    let [position, orientation, configuration, _] = elements(&point.value)?;
    let (mut edits, position) = replaced(position, &pose.position.into(), text, DECIMALS_MM)?;
    let taught: [f64; 4] = orientation.numbers().ok_or(CompensationFinding::PointShape { numbers: 4 })?;
    // Of the two quaternions of an orientation the one nearer to the taught one.
    let new = pose.quaternion();
    let cosine: f64 = taught.iter().zip(new).map(|(taught, new)| taught * new).sum();
    let new = new.map(|part| if cosine < 0.0 { -part } else { part });
    let (orientation_edits, quaternion) = replaced(orientation, &new, text, DECIMALS_QUATERNION)?;
    edits.extend(orientation_edits);
    let printed =
        Pose::from_quaternion(position, quaternion).ok_or(CompensationFinding::PointShape { numbers: 4 })?;
    let quadrants = corrector.quadrants(corrected, &printed, frames)?;
    for (old, new) in elements::<4>(configuration)?.iter().zip(quadrants) {
        if old.number() != Some(f64::from(new)) {
            edits.push((old.span.clone(), new.to_string()));
        }
    }
    Ok(edits)
}
