//! Reads the points of a program: what is commanded, in order, and where it stands in the text.

use std::collections::BTreeMap;

use super::syntax::*;
use crate::diag::Diagnostic;
use crate::model::AXES;
use crate::plan::Motion;

/// A commanded motion.
#[derive(Clone, Debug)]
pub struct Point {
    /// How the robot comes there.
    pub motion: Motion,
    /// Where to.
    pub to: Target,
    /// The auxiliary point of an arc.
    pub through: Option<Target>,
    /// The angle round which an arc goes, degrees, where it does not end at `to`.
    pub sweep_deg: Option<f64>,
    /// The statement's bytes in the `.src`.
    pub span: Span,
}

/// A commanded position, to the digits that are printed.
#[derive(Clone, Debug, PartialEq)]
pub enum Target {
    /// Axis angles, degrees.
    Axes([f64; AXES]),
    /// A pose of the tool in the base frame.
    Pose {
        /// X, Y, Z, mm.
        xyz_mm: [f64; 3],
        /// A, B, C, degrees.
        abc_deg: [f64; 3],
        /// KUKA's status bits, where they are given.
        status: Option<i64>,
        /// KUKA's turn bits, where they are given.
        turn: Option<i64>,
    },
}

/// The points of a program's first routine, in order.
///
/// # Errors
/// Motions inside loops, choices or routines that are called; a point that is no constant or lacks a
/// component.
pub fn read_points(source: &Source, data: Option<&Data>) -> Result<Vec<Point>, Diagnostic> {
    let constants = data.map(Constants::new).transpose()?.unwrap_or_default();
    let wrong =
        |span: &Span, message: String| Diagnostic::span(&source.file, &source.text, span.clone(), message);
    let mut points = Vec::new();
    let Some(main) = source.routines.first() else { return Ok(points) };
    for statement in main.body.iter() {
        let target = |expression: &Expression| {
            constants.target(expression).map_err(|message| wrong(&expression.span, message))
        };
        let mut sweep_deg = None;
        let (motion, to, through) = match &statement.kind {
            StatementKind::Ptp { to, .. } => (Motion::Ptp, target(to)?, None),
            StatementKind::Lin { to, .. } => (Motion::Lin, target(to)?, None),
            StatementKind::Circ { through, to, angle, .. } => {
                sweep_deg = angle
                    .as_ref()
                    .map(|angle| number(angle).map_err(|why| wrong(&angle.span, why)))
                    .transpose()?;
                (Motion::Circ, target(to)?, Some(target(through)?))
            }
            StatementKind::Call { name, .. } => {
                let called = source.routines.iter().find(|routine| routine.name == *name);
                if called.is_some_and(|routine| moves(&routine.body)) {
                    return Err(wrong(&statement.span, format!("{name} moves the robot"))
                        .help("put its motions into the first routine"));
                }
                continue;
            }
            _ if moves(std::slice::from_ref(statement)) => {
                return Err(wrong(
                    &statement.span,
                    "a motion inside a loop or a choice has no fixed place".into(),
                )
                .help("write the motions one after the other"));
            }
            _ => continue,
        };
        points.push(Point { motion, to, through, sweep_deg, span: statement.span.clone() });
    }
    Ok(points)
}

/// The axis angles (degrees) that the program logged into its `.dat`, with the row of the plan for each.
///
/// # Errors
/// A `.dat` without the arrays `DBBROW` and `XQ` that dbbd writes, or a value in them that is no constant.
pub fn logged_axes(data: &Data) -> Result<Vec<(u32, [f64; AXES])>, Diagnostic> {
    let constants = Constants::new(data)?;
    let (Some(rows), Some(logged)) = (constants.arrays.get("DBBROW"), constants.arrays.get("XQ")) else {
        return Err(Diagnostic::file(&data.file, "holds no arrays DBBROW and XQ")
            .help("give the .dat of a module that dbbd wrote, fetched from the controller after the run"));
    };
    let mut found = Vec::new();
    for (at, expression) in logged {
        let wrong =
            |message: String| Diagnostic::span(&data.file, &data.text, expression.span.clone(), message);
        let Some(Expression { kind: ExpressionKind::Int(row), .. }) = rows.get(at) else {
            return Err(wrong(format!("there is no DBBROW[{at}] for this")));
        };
        let row = u32::try_from(*row).map_err(|_| wrong(format!("DBBROW[{at}] = {row} is no row")))?;
        match constants.target(expression).map_err(wrong)? {
            Target::Axes(axes_deg) => found.push((row, axes_deg)),
            Target::Pose { .. } => return Err(wrong("expected axis angles".into())),
        }
    }
    Ok(found)
}

/// The hash of the plan that a `.dat` of dbbd names.
pub fn plan_hash(data: &Data) -> Option<String> {
    data.items.iter().find_map(|item| match item {
        DataItem::Value { target, value } if target.name == "DBBPLAN" => match &value.kind {
            ExpressionKind::Text(text) => Some(text.clone()),
            _ => None,
        },
        _ => None,
    })
}

/// Whether the controller corrected by an accuracy model of its own (`$ABS_ACCUR`), where the `.dat` tells.
pub fn own_accuracy(data: &Data) -> Option<bool> {
    match Constants::new(data).ok()?.scalars.get("DBBABS")?.kind {
        ExpressionKind::Bool(on) => Some(on),
        _ => None,
    }
}

/// The ball and the bar that a module's `.dat` names.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setup {
    /// Number of the base ball, from 1.
    pub ball: u32,
    /// Its centre in the robot base, mm.
    pub centre_mm: [f64; 3],
    /// Distance between the ball centres at reading zero, mm.
    pub length_mm: f64,
    /// Lowest and highest reading, mm.
    pub stroke_mm: [f64; 2],
}

/// The set-up that dbbd wrote into a `.dat`; `None` where it is not there, whole.
///
/// # Errors
/// An index in the file that is no number.
pub fn read_setup(data: &Data) -> Result<Option<Setup>, Diagnostic> {
    let constants = Constants::new(data)?;
    let number = |name: &str| match constants.scalars.get(name)?.kind {
        ExpressionKind::Real(value) => Some(value),
        ExpressionKind::Int(value) => Some(value as f64),
        _ => None,
    };
    let ball = match constants.scalars.get("DBBBALL").map(|ball| &ball.kind) {
        Some(ExpressionKind::Int(ball)) => u32::try_from(*ball).ok(),
        _ => None,
    };
    let centre = constants.scalars.get("DBBCEN").and_then(|frame| constants.target(frame).ok());
    let (Some(ball), Some(Target::Pose { xyz_mm, .. })) = (ball, centre) else { return Ok(None) };
    let (Some(length_mm), Some(low), Some(high)) = (number("DBBLEN"), number("DBBLOW"), number("DBBHIGH"))
    else {
        return Ok(None);
    };
    Ok(Some(Setup { ball, centre_mm: xyz_mm, length_mm, stroke_mm: [low, high] }))
}

/// A number that is written as such.
fn number(expression: &Expression) -> Result<f64, String> {
    match &expression.kind {
        ExpressionKind::Real(value) => Ok(*value),
        ExpressionKind::Int(value) => Ok(*value as f64),
        ExpressionKind::Unary(Unary::Minus, inner) => number(inner).map(|value| -value),
        _ => Err("this is no number".into()),
    }
}

/// Whether a block or one inside it holds a motion.
fn moves(block: &[Statement]) -> bool {
    block.iter().any(|statement| match &statement.kind {
        StatementKind::Ptp { .. } | StatementKind::Lin { .. } | StatementKind::Circ { .. } => true,
        StatementKind::For { body, .. } | StatementKind::While { body, .. } | StatementKind::Loop(body) => {
            moves(body)
        }
        StatementKind::If { then, otherwise, .. } => moves(then) || moves(otherwise),
        _ => false,
    })
}

/// Values that a `.dat` gives.
#[derive(Default)]
struct Constants<'a> {
    scalars: BTreeMap<&'a str, &'a Expression>,
    arrays: BTreeMap<&'a str, BTreeMap<i64, &'a Expression>>,
}

impl<'a> Constants<'a> {
    fn new(data: &'a Data) -> Result<Self, Diagnostic> {
        let mut constants = Self::default();
        for item in &data.items {
            match item {
                DataItem::Declaration(Declaration {
                    kind: DeclarationKind::Variables { names, .. }, ..
                }) => {
                    for declared in names {
                        if declared.elements.is_some() {
                            constants.arrays.insert(&declared.name, BTreeMap::new());
                        } else if let Some(value) = &declared.value {
                            constants.scalars.insert(&declared.name, value);
                        }
                    }
                }
                DataItem::Declaration(_) => {}
                DataItem::Value { target, value } => match target.parts.as_slice() {
                    [Part::Element(index)] => {
                        let ExpressionKind::Int(index) = index.kind else {
                            let message = "an index in a .dat file is a number";
                            return Err(Diagnostic::span(
                                &data.file,
                                &data.text,
                                target.span.clone(),
                                message,
                            ));
                        };
                        constants.arrays.entry(&target.name).or_default().insert(index, value);
                    }
                    [] => {
                        constants.scalars.insert(&target.name, value);
                    }
                    _ => {} // texts and members carry no points
                },
            }
        }
        Ok(constants)
    }

    fn value(&self, expression: &'a Expression) -> Result<&'a Expression, String> {
        let ExpressionKind::Place(place) = &expression.kind else { return Ok(expression) };
        let found = match place.parts.as_slice() {
            [] => self.scalars.get(place.name.as_str()),
            [Part::Element(index)] => match index.kind {
                ExpressionKind::Int(at) => {
                    self.arrays.get(place.name.as_str()).and_then(|array| array.get(&at))
                }
                _ => return Err("the index is no number".into()),
            },
            _ => None,
        };
        found.copied().ok_or_else(|| format!("{} has no value in the .dat file", place.name))
    }

    fn target(&self, expression: &'a Expression) -> Result<Target, String> {
        let ExpressionKind::Aggregate(fields) = &self.value(expression)?.kind else {
            return Err("this is no point".into());
        };
        let find = |name: &str| fields.iter().find(|field| field.name == name).map(|field| &field.value.kind);
        let number = |name: &str| match find(name) {
            Some(ExpressionKind::Real(value)) => Ok(*value),
            Some(ExpressionKind::Int(value)) => Ok(*value as f64),
            Some(_) => Err(format!("{name} is no number")),
            None => Err(format!("the point has no {name}")),
        };
        let bits = |name: &str| match find(name) {
            Some(ExpressionKind::Int(value)) => Ok(Some(*value)),
            Some(_) => Err(format!("{name} is no whole number")),
            None => Ok(None),
        };
        if find("A1").is_some() {
            let mut axes_deg = [0.0; AXES];
            for (axis, name) in ["A1", "A2", "A3", "A4", "A5", "A6"].into_iter().enumerate() {
                axes_deg[axis] = number(name)?;
            }
            return Ok(Target::Axes(axes_deg));
        }
        Ok(Target::Pose {
            xyz_mm: [number("X")?, number("Y")?, number("Z")?],
            abc_deg: [number("A")?, number("B")?, number("C")?],
            status: bits("S")?,
            turn: bits("T")?,
        })
    }
}
