//! The motions of a program made on a controller (inline forms, taught points) or by dbbd, in order, with their points and
//! frames.
//!
//! A program is corrected, not executed, so only motions and what sets `$TOOL` and `$BASE` matter here. The text is read
//! line by line and other statements are skipped: unlike the parser, this reader must accept any program that a controller
//! accepts.

mod frames;
mod line;

use std::collections::HashMap;

use self::frames::{ActiveFrames, Definitions, FrameKind, FrameTracker, unknown};
use self::line::{Line, lines};
use super::data::{Constant, Constants, Origin, key};
use super::evaluate::{AXIS_NAMES, EXTERNAL_NAMES, POSE_NAMES, constant_target};
use super::statement::motion_of;
use super::syntax::{DataItem, Expression, ExpressionKind, Part, Place, Span, Text};
use crate::plan::MotionKind;
use crate::program::CompensationFinding;
use crate::program::ProgramFinding;
use crate::program::compensate::{External, external_motion};
use crate::program::lexer::Token;
use crate::program::{Frames, Target};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::Pose;

#[derive(Clone, Copy, Debug)]
pub struct Files<'a> {
    /// `NAME.src`
    pub source: Text<'a>,
    /// `NAME.dat`, if there is one.
    pub data: Option<Text<'a>>,
    /// `$config.dat`, which holds `TOOL_DATA` and `BASE_DATA`.
    pub config: Option<Text<'a>>,
}

/// `$TOOL` and `$BASE` as the user gives them, for a program that does not set them.
#[derive(Clone, Copy, Debug, Default)]
pub struct Given {
    /// In the flange frame.
    pub tool: Option<Pose>,
    /// In the robot base.
    pub base: Option<Pose>,
}

/// A point to which the program moves.
#[derive(Clone, Debug)]
pub struct TaughtPoint {
    /// `inline` if it has no name.
    pub name: String,
    /// The file that holds its numbers.
    pub origin: Origin,
    /// Its bytes there.
    pub span: Span,
    /// The first statement in the `.src` that moves there.
    pub first_use: Span,
    /// Whether a PTP or SPTP moves there: only these obey status and turn.
    pub by_ptp: bool,
    pub target: Target,
    /// The bytes of its six numbers.
    pub numbers: [Span; 6],
    /// The bytes of its turn bits.
    pub turn: Option<Span>,
    external: External,
    /// The frames that are active there; `None` for axis angles.
    pub frames: Option<Frames>,
}

/// A motion. Its points are indices into [`PointProgram::points`]: several where the index of an array element is computed,
/// none for a point that is not in the program's files.
#[derive(Clone, Debug)]
pub struct ProgramMotion {
    pub motion: MotionKind,
    /// The auxiliary point of an arc.
    pub through: Vec<usize>,
    pub to: Vec<usize>,
    /// `CA`: the sweep of an arc that does not end at `to`, degrees.
    pub sweep_deg: Option<f64>,
}

#[derive(Clone, Debug, Default)]
pub struct PointProgram {
    /// In the order of the text.
    pub motions: Vec<ProgramMotion>,
    /// The points of the program's own files, each once, in the order of their first use.
    pub points: Vec<TaughtPoint>,
    /// Uses of points that are not corrected: relative motions, points declared elsewhere, arguments of routines.
    pub not_corrected: Vec<Diagnostic>,
    /// What makes all corrections doubtful.
    pub doubts: Vec<Diagnostic>,
}

/// A tool or base of the user that differs by more (mm, or of the rotation matrix) from the program's is another one.
const SAME: f64 = 1e-6;

pub fn read(files: Files<'_>, given: Given) -> Result<PointProgram, Diagnostic> {
    let config = files.config.map(data_items).transpose()?.unwrap_or_default();
    let data = files.data.map(data_items).transpose()?.unwrap_or_default();
    let mut constants = Constants::default();
    constants.add(&config, Origin::Config);
    constants.add(&data, Origin::Data);
    let assignments: Vec<(Line<'_>, Option<DataItem>)> =
        lines(files.source).filter(Line::is_assignment).map(|line| assignment(files.source, line)).collect();
    let mut variables = HashMap::new();
    for (line, item) in &assignments {
        // A point or frame that is assigned once, as an aggregate, is a constant.
        let constant = item.as_ref().and_then(|item| {
            let DataItem::Value { target, value } = item else { return None };
            let key = key(target).filter(|key| constants.get(*key).is_none())?;
            matches!(value.kind, ExpressionKind::Aggregate(_)).then_some((key, value))
        });
        match constant {
            Some((key, value)) => constants.insert(key, Constant { value, origin: Origin::Source }),
            None => _ = variables.insert(line.word.clone(), line.span.clone()),
        }
    }
    Reader {
        files,
        given,
        definitions: Definitions { file: files.source, constants, variables },
        by_name: HashMap::new(),
        program: PointProgram::default(),
        given_for: [None, None],
    }
    .read()
}

/// Refuses a file without a KRL routine.
fn check_is_krl(file: Text<'_>) -> Result<(), Diagnostic> {
    let routine = lines(file).find(|line| line.routine().is_some());
    // `def` of URScript ends with a colon.
    if routine.as_ref().is_some_and(|line| line.code().ends_with(')')) {
        return Ok(());
    }
    let first = routine.or_else(|| lines(file).next());
    let begins = first.as_ref().map_or_else(String::new, |line| line.code().chars().take(40).collect());
    Err(file.wrong(&first.map_or(0..0, |line| line.span), CompensationFinding::NotKrl { begins }))
}

/// The points and frames of a `.dat` file of any controller; other lines are skipped.
fn data_items(file: Text<'_>) -> Result<Vec<DataItem>, Diagnostic> {
    let items = lines(file).filter(|line| line.holds_structure());
    items.map(|line| line.parser(file)?.data_item()).collect()
}

/// An assignment of the `.src`, with its target and value if these can be parsed.
fn assignment<'l>(file: Text<'_>, line: Line<'l>) -> (Line<'l>, Option<DataItem>) {
    let item = line.parser(file).and_then(|mut parser| parser.data_item()).ok();
    (line, item)
}

struct Reader<'a> {
    files: Files<'a>,
    given: Given,
    definitions: Definitions<'a>,
    /// The index of each named point in the program's points.
    by_name: HashMap<(String, Option<i64>), usize>,
    program: PointProgram,
    /// Why the frames of the user are used: the reason for which the program's own are unknown.
    given_for: [Option<CompensationFinding>; 2],
}

/// The motion that is being read.
struct Current<'l> {
    line: &'l Line<'l>,
    frames: ActiveFrames,
    by_ptp: bool,
}

impl<'a> Reader<'a> {
    fn read(mut self) -> Result<PointProgram, Diagnostic> {
        let file = self.files.source;
        check_is_krl(file)?;
        let frame_setters = self.routines_that_set_frames();
        let mut tracker = FrameTracker::new();
        let mut spline: Option<ActiveFrames> = None;
        let mut named = Vec::new();
        for line in lines(file) {
            if tracker.control_flow(file, &line)? {
                continue;
            }
            match line.word.as_str() {
                "DEF" | "DEFFCT" | "GLOBAL" if line.routine().is_some() => tracker = FrameTracker::new(),
                "SPLINE" | "PTP_SPLINE" => {
                    let mut frames = tracker.active.clone();
                    self.definitions.with(&mut frames, &mut line.parser(file)?)?;
                    spline = Some(frames);
                }
                "ENDSPLINE" => spline = None,
                word if motion_of(word).is_some() => {
                    let frames = spline.as_ref().unwrap_or(&tracker.active).clone();
                    if self.motion(&line, frames)? == tracker.active {
                        tracker.note_use(&line.span);
                    }
                }
                _ if line.is_relative_motion() => {
                    let relative = file.wrong(&line.span, CompensationFinding::RelativeMotion);
                    self.program.not_corrected.push(relative);
                }
                _ if self.definitions.set(&mut tracker.active, &line)? => {}
                word => {
                    named.extend(self.points_in(&line));
                    if frame_setters.iter().any(|name| name == word) {
                        tracker.active = unknown(|frame| CompensationFinding::FrameInRoutine {
                            frame,
                            routine: word.into(),
                        });
                    }
                }
            }
        }
        // A point to which a motion goes as well is corrected.
        named.retain(|(name, _)| !self.by_name.keys().any(|(corrected, _)| corrected == name));
        let in_statements = named
            .into_iter()
            .map(|(name, span)| file.wrong(&span, CompensationFinding::PointInStatement { name }));
        self.program.not_corrected.extend(in_statements);
        let points = &self.program.points;
        let external = external_motion(points.iter().map(|point| (point.name.as_str(), point.external)));
        let external = external.map(|(at, finding)| file.wrong(&points[at].first_use, finding));
        self.program.doubts.extend(external);
        Ok(self.program)
    }

    /// The points of the program's files that a statement other than a motion uses: in a call, in an assignment.
    fn points_in(&self, line: &Line<'_>) -> Vec<(String, Span)> {
        let mut words = line.words();
        if line.is_assignment() {
            words.next();
        }
        let constants = &self.definitions.constants;
        words.filter(|(word, _)| !word.starts_with("XHOME") && constants.has_point(word)).collect()
    }

    /// The routines of the file that set a frame: after a call of one, the frames are unknown.
    fn routines_that_set_frames(&self) -> Vec<String> {
        let mut names: Vec<String> = Vec::new();
        let mut routine = String::new();
        for line in lines(self.files.source) {
            let sets_frame = match line.word.as_str() {
                "DEF" | "DEFFCT" | "GLOBAL" => {
                    routine = line.routine().unwrap_or(routine);
                    false
                }
                "$TOOL" | "$BASE" | "FDAT_ACT" => true,
                "BAS" => {
                    let code = line.code().to_ascii_uppercase().replace(' ', "");
                    code.starts_with("BAS(#TOOL") || code.starts_with("BAS(#BASE")
                }
                _ => false,
            };
            if sets_frame && names.last() != Some(&routine) {
                names.push(routine.clone());
            }
        }
        names
    }

    /// Adds a motion; the frames under which it runs.
    fn motion(&mut self, line: &Line<'_>, mut frames: ActiveFrames) -> Result<ActiveFrames, Diagnostic> {
        let mut parser = line.parser(self.files.source)?;
        let mut motion = parser.motion()?;
        if matches!(parser.tokens.peek(), Token::Sign(":")) {
            return Err(self.files.source.wrong(&line.span, CompensationFinding::PointExpression));
        }
        motion.angle = parser.angle()?;
        self.definitions.with(&mut frames, &mut parser)?;
        let current = Current { line, frames, by_ptp: motion.motion == MotionKind::Ptp };
        let through = match &motion.through {
            Some(through) => self.target(through, &current)?,
            None => Vec::new(),
        };
        let to = self.target(&motion.to, &current)?;
        let sweep_deg = motion.angle.and_then(|angle| angle.constant().ok()?.number().ok());
        self.program.motions.push(ProgramMotion { motion: motion.motion, through, to, sweep_deg });
        Ok(current.frames)
    }

    /// Adds the point or points that a target may mean; their indices.
    fn target(&mut self, target: &Expression, current: &Current<'_>) -> Result<Vec<usize>, Diagnostic> {
        let file = self.files.source;
        let place = match &target.kind {
            ExpressionKind::Aggregate(_) => {
                let inline = Constant { value: target, origin: Origin::Source };
                let point = self.point("inline", inline, current)?;
                self.program.points.push(point);
                return Ok(vec![self.program.points.len() - 1]);
            }
            ExpressionKind::Place(place) => place,
            ExpressionKind::Int(_)
            | ExpressionKind::Real(_)
            | ExpressionKind::Bool(_)
            | ExpressionKind::Enum(_)
            | ExpressionKind::Text(_)
            | ExpressionKind::Call { .. }
            | ExpressionKind::Unary(..)
            | ExpressionKind::Binary(..) => {
                return Err(file.wrong(&target.span, CompensationFinding::PointExpression));
            }
        };
        if let Some(assignment) = self.definitions.variables.get(&place.name) {
            let line = file.line(assignment.start);
            let computed = CompensationFinding::PointComputed { name: place.name.clone(), line };
            return Err(file.wrong(&place.span, computed));
        }
        let elements = match (key(place), place.parts.as_slice()) {
            (Some((_, index)), _) => vec![index],
            // The index is computed: any element may be meant.
            (None, [Part::Element(_)]) => {
                self.definitions.constants.elements(&place.name).map(Some).collect()
            }
            _ => Vec::new(),
        };
        let mut indices = Vec::new();
        for element in elements {
            indices.extend(self.named_point(place, element, current)?);
        }
        if indices.is_empty() && !place.name.starts_with("XHOME") {
            let elsewhere = CompensationFinding::PointElsewhere { name: place.name.clone() };
            self.program.not_corrected.push(file.wrong(&place.span, elsewhere));
        }
        Ok(indices)
    }

    /// Adds a named point, unless it must not be rewritten (home positions, `$config.dat`); its index.
    fn named_point(
        &mut self,
        place: &Place,
        element: Option<i64>,
        current: &Current<'_>,
    ) -> Result<Option<usize>, Diagnostic> {
        let constant = self.definitions.constants.get((place.name.as_str(), element));
        let Some(constant) = constant.filter(|constant| constant.origin != Origin::Config) else {
            return Ok(None);
        };
        if place.name.starts_with("XHOME") {
            return Ok(None);
        }
        let name = match element {
            Some(index) => format!("{}[{index}]", place.name),
            None => place.name.clone(),
        };
        let point = self.point(&name, constant, current)?;
        let points = &mut self.program.points;
        let at = *self.by_name.entry((place.name.clone(), element)).or_insert(points.len());
        match points.get_mut(at) {
            None => points.push(point),
            Some(known) if known.frames == point.frames => known.by_ptp |= current.by_ptp,
            Some(known) => {
                let line = self.files.source.line(known.first_use.start);
                let twice = CompensationFinding::PointTwice { name, line };
                return Err(self.files.source.wrong(&place.span, twice));
            }
        }
        Ok(Some(at))
    }

    fn point(
        &mut self,
        name: &str,
        constant: Constant<'_>,
        current: &Current<'_>,
    ) -> Result<TaughtPoint, Diagnostic> {
        let Constant { value, origin } = constant;
        let file = match (origin, self.files.data) {
            (Origin::Data, Some(data)) => data,
            _ => self.files.source,
        };
        let incomplete = |why: String| {
            file.wrong(&value.span, CompensationFinding::PointIncomplete { name: name.into(), why })
        };
        let target = constant_target(value).map_err(|fault| incomplete(fault.finding.to_string()))?;
        let span = |name: &str| {
            if let ExpressionKind::Aggregate(fields) = &value.kind {
                fields.iter().find(|field| field.name == name).map(|field| field.value.span.clone())
            } else {
                None
            }
        };
        let number = |name: &str| {
            if let ExpressionKind::Aggregate(fields) = &value.kind {
                let field = fields.iter().find(|field| field.name == name)?;
                field.value.constant().ok()?.number().ok()
            } else {
                None
            }
        };
        let names = if matches!(target, Target::Axes(_)) { AXIS_NAMES } else { POSE_NAMES };
        let [Some(a), Some(b), Some(c), Some(d), Some(e), Some(f)] = names.map(span) else {
            return Err(incomplete(ProgramFinding::NoPosition.to_string()));
        };
        let frames = match target {
            Target::Axes(_) => None,
            Target::Pose { .. } => {
                let tool = self.frame(FrameKind::Tool, current)?;
                Some(Frames { tool, base: self.frame(FrameKind::Base, current)? })
            }
        };
        Ok(TaughtPoint {
            name: name.into(),
            origin,
            span: value.span.clone(),
            first_use: current.line.span.clone(),
            by_ptp: current.by_ptp,
            target,
            numbers: [a, b, c, d, e, f],
            turn: span("T"),
            external: EXTERNAL_NAMES.map(number),
            frames,
        })
    }

    /// The frame that the program sets, else the one that the user gave.
    fn frame(&mut self, kind: FrameKind, current: &Current<'_>) -> Result<Pose, Diagnostic> {
        let (at, active) = (kind as usize, &current.frames[kind as usize]);
        let (given, given_for) = ([self.given.tool, self.given.base][at], &mut self.given_for[at]);
        let wrong = |finding: CompensationFinding| self.files.source.wrong(&current.line.span, finding);
        let stated = kind.stated();
        match (active, given) {
            (Ok(pose), None) => Ok(*pose),
            (Ok(pose), Some(given)) => {
                let off = (pose.position - given.position).norm() + (pose.rotation - given.rotation).norm();
                if off > SAME {
                    return Err(wrong(CompensationFinding::FrameDiffers { frame: kind.name(), stated }));
                }
                Ok(*pose)
            }
            (Err(why), None) => Err(wrong(why.clone())),
            (Err(why), Some(given)) => match given_for {
                Some(before) if before != why => {
                    let (first, second) = (before.to_string(), why.to_string());
                    Err(wrong(CompensationFinding::TwoFrames { stated, first, second }))
                }
                _ => {
                    *given_for = Some(why.clone());
                    Ok(given)
                }
            },
        }
    }
}
