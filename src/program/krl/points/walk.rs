//! Goes through a program's lines for its motions.

use std::collections::HashMap;

use super::frames::{Follower, Following, Slot, Values, unknown};
use super::line::{Line, lines};
use super::{Files, Given, Leg, PointProgram, TaughtPoint};
use crate::catalogue::{CompensationFinding, ProgramFinding};
use crate::diagnostic::Diagnostic;
use crate::plan::Motion;
use crate::program::krl::data::{Constant, Constants, Origin, key};
use crate::program::krl::evaluate::{AXIS_NAMES, POSE_NAMES, constant_target};
use crate::program::krl::lexer::Token;
use crate::program::krl::statement::motion_of;
use crate::program::krl::syntax::{DataItem, Expression, ExpressionKind, Part, Place, Span, Text};
use crate::program::{Frames, Target};
use crate::robot::Pose;

/// A tool or base that is given differs by this much (mm, or of a rotation matrix) from the program's.
const SAME: f64 = 1e-6;

pub(super) fn read(files: Files<'_>, given: Given) -> Result<PointProgram, Diagnostic> {
    let config = files.config.map(scan).transpose()?.unwrap_or_default();
    let data = files.data.map(scan).transpose()?.unwrap_or_default();
    let mut constants = Constants::default();
    constants.add(&config, Origin::Config);
    constants.add(&data, Origin::Data);
    let mut varying = HashMap::new();
    let set: Vec<(Span, String, Option<DataItem>)> =
        lines(files.source).filter(Line::assigns).map(|line| assignment(files.source, line)).collect();
    for (span, name, item) in &set {
        let first = item.as_ref().and_then(|item| {
            let DataItem::Value { target, value } = item else { return None };
            let key = key(target).filter(|key| constants.get(*key).is_none())?;
            matches!(value.kind, ExpressionKind::Aggregate(_)).then_some((key, value))
        });
        match first {
            Some((key, value)) => constants.insert(key, Constant { value, origin: Origin::Source }),
            None => _ = varying.insert(name.clone(), span.clone()),
        }
    }
    Walk {
        files,
        given,
        values: Values { file: files.source, constants, varying },
        found: HashMap::new(),
        program: PointProgram::default(),
        given_for: [None, None],
    }
    .read()
}

/// That the file is KRL: it has a routine, whose first line is no function of another language.
fn is_krl(file: Text<'_>) -> Result<(), Diagnostic> {
    let routine = lines(file).find(|line| line.routine().is_some());
    if routine.as_ref().is_some_and(|line| line.code().ends_with(')')) {
        return Ok(());
    }
    let first = routine.or_else(|| lines(file).next());
    let begins = first.as_ref().map_or_else(String::new, |line| line.code().chars().take(40).collect());
    Err(file.wrong(&first.map_or(0..0, |line| line.span), CompensationFinding::NotKrl { begins }))
}

/// The points and frames of a `.dat` file of any controller; other lines are passed over.
fn scan(file: Text<'_>) -> Result<Vec<DataItem>, Diagnostic> {
    let items = lines(file).filter(|line| line.holds_structure());
    items.map(|line| line.parser(file)?.data_item()).collect()
}

/// What a line of the `.src` sets: its bytes, the variable, and the value where it can be read.
fn assignment(file: Text<'_>, line: Line<'_>) -> (Span, String, Option<DataItem>) {
    let item = line.parser(file).and_then(|mut parser| parser.data_item()).ok();
    (line.span, line.word, item)
}

struct Walk<'a> {
    files: Files<'a>,
    given: Given,
    values: Values<'a>,
    /// Where each named point is in the program's points.
    found: HashMap<(String, Option<i64>), usize>,
    program: PointProgram,
    /// What `--tool` and `--base` are used for: why the program's own are not known.
    given_for: [Option<CompensationFinding>; 2],
}

/// A motion and the frames under which it runs.
struct Running<'l> {
    line: &'l Line<'l>,
    frames: Following,
    by_ptp: bool,
}

impl<'a> Walk<'a> {
    fn read(mut self) -> Result<PointProgram, Diagnostic> {
        let file = self.files.source;
        is_krl(file)?;
        let setters = self.routines_that_set_frames();
        let mut follower = Follower::new();
        let mut spline: Option<Following> = None;
        let mut named = Vec::new();
        for line in lines(file) {
            if follower.control(file, &line)? {
                continue;
            }
            match line.word.as_str() {
                "DEF" | "DEFFCT" | "GLOBAL" if line.routine().is_some() => follower = Follower::new(),
                "SPLINE" | "PTP_SPLINE" => {
                    let mut under = follower.now.clone();
                    self.values.with(&mut under, &mut line.parser(file)?)?;
                    spline = Some(under);
                }
                "ENDSPLINE" => spline = None,
                word if motion_of(word).is_some() => {
                    let under = spline.as_ref().unwrap_or(&follower.now).clone();
                    if self.motion(&line, under)? == follower.now {
                        follower.used(&line.span);
                    }
                }
                _ if line.is_relative() => {
                    self.program.left.push(file.wrong(&line.span, CompensationFinding::RelativeMotion));
                }
                word => {
                    let set = self.values.set(&mut follower.now, &line)?;
                    if !set {
                        named.extend(self.points_in(&line));
                    }
                    if !set && setters.iter().any(|name| name == word) {
                        follower.now = unknown(|frame| CompensationFinding::FrameInRoutine {
                            frame,
                            routine: word.into(),
                        });
                    }
                }
            }
        }
        // A point that a motion goes to as well is corrected.
        named.retain(|(name, _)| !self.found.keys().any(|(found, _)| found == name));
        let left = named
            .into_iter()
            .map(|(name, span)| file.wrong(&span, CompensationFinding::PointInStatement { name }));
        self.program.left.extend(left);
        Ok(self.program)
    }

    /// The points of the program's files that a statement names which is no motion: an argument of a routine, a copy.
    fn points_in(&self, line: &Line<'_>) -> Vec<(String, Span)> {
        let mut words = line.words();
        if line.assigns() {
            words.next();
        }
        let named =
            words.filter(|(word, _)| !word.starts_with("XHOME") && self.values.constants.has_point(word));
        named.collect()
    }

    /// The file's routines that set a frame: after a call of one nothing is known.
    fn routines_that_set_frames(&self) -> Vec<String> {
        let mut names: Vec<String> = Vec::new();
        let mut routine = String::new();
        for line in lines(self.files.source) {
            let sets = match line.word.as_str() {
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
            if sets && names.last() != Some(&routine) {
                names.push(routine.clone());
            }
        }
        names
    }

    /// Takes a motion; the frames under which it runs.
    fn motion(&mut self, line: &Line<'_>, mut frames: Following) -> Result<Following, Diagnostic> {
        let mut parser = line.parser(self.files.source)?;
        let mut motion = parser.motion()?;
        if matches!(parser.peek(), Token::Sign(":")) {
            return Err(self.files.source.wrong(&line.span, CompensationFinding::PointExpression));
        }
        motion.angle = parser.angle()?;
        self.values.with(&mut frames, &mut parser)?;
        let running = Running { line, frames, by_ptp: motion.motion == Motion::Ptp };
        let through = match &motion.through {
            Some(through) => self.target(through, &running)?,
            None => Vec::new(),
        };
        let to = self.target(&motion.to, &running)?;
        let sweep_deg = motion.angle.and_then(|angle| angle.constant().ok()?.number().ok());
        self.program.legs.push(Leg { motion: motion.motion, through, to, sweep_deg });
        Ok(running.frames)
    }

    /// Takes the point or points that a motion goes to.
    fn target(&mut self, target: &Expression, running: &Running<'_>) -> Result<Vec<usize>, Diagnostic> {
        let file = self.files.source;
        let place = match &target.kind {
            ExpressionKind::Aggregate(_) => {
                let inline = Constant { value: target, origin: Origin::Source };
                let point = self.point("inline", inline, running)?;
                self.program.points.push(point);
                return Ok(vec![self.program.points.len() - 1]);
            }
            ExpressionKind::Place(place) => place,
            _ => return Err(file.wrong(&target.span, CompensationFinding::PointExpression)),
        };
        if let Some(set) = self.values.varying.get(&place.name) {
            let computed =
                CompensationFinding::PointComputed { name: place.name.clone(), line: file.line(set.start) };
            return Err(file.wrong(&place.span, computed));
        }
        let elements = match (key(place), place.parts.as_slice()) {
            (Some((_, index)), _) => vec![index],
            // An index that is computed: any element may be meant.
            (None, [Part::Element(_)]) => self.values.constants.elements(&place.name).map(Some).collect(),
            _ => Vec::new(),
        };
        let mut taken = Vec::new();
        for element in elements {
            taken.extend(self.element(place, element, running)?);
        }
        if taken.is_empty() && !place.name.starts_with("XHOME") {
            let elsewhere = CompensationFinding::PointElsewhere { name: place.name.clone() };
            self.program.left.push(file.wrong(&place.span, elsewhere));
        }
        Ok(taken)
    }

    /// Takes a named point, if it may be rewritten.
    fn element(
        &mut self,
        place: &Place,
        element: Option<i64>,
        running: &Running<'_>,
    ) -> Result<Option<usize>, Diagnostic> {
        let constant = self.values.constants.get((place.name.as_str(), element));
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
        let point = self.point(&name, constant, running)?;
        let points = &mut self.program.points;
        let at = *self.found.entry((place.name.clone(), element)).or_insert(points.len());
        match points.get_mut(at) {
            None => points.push(point),
            Some(before) if before.frames == point.frames => before.by_ptp |= running.by_ptp,
            Some(before) => {
                let line = self.files.source.line(before.used.start);
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
        running: &Running<'_>,
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
        let span = |name: &str| match &value.kind {
            ExpressionKind::Aggregate(fields) => {
                fields.iter().find(|field| field.name == name).map(|field| field.value.span.clone())
            }
            _ => None,
        };
        let names = if matches!(target, Target::Axes(_)) { AXIS_NAMES } else { POSE_NAMES };
        let [Some(a), Some(b), Some(c), Some(d), Some(e), Some(f)] = names.map(span) else {
            return Err(incomplete(ProgramFinding::NoPosition.to_string()));
        };
        let frames = match target {
            Target::Axes(_) => None,
            Target::Pose { .. } => {
                let tool = self.resolve(Slot::Tool, running)?;
                Some(Frames { tool, base: self.resolve(Slot::Base, running)? })
            }
        };
        Ok(TaughtPoint {
            name: name.into(),
            origin,
            span: value.span.clone(),
            used: running.line.span.clone(),
            by_ptp: running.by_ptp,
            target,
            numbers: [a, b, c, d, e, f],
            turn: span("T"),
            frames,
        })
    }

    /// What the program sets, else what the user gave.
    fn resolve(&mut self, slot: Slot, running: &Running<'_>) -> Result<Pose, Diagnostic> {
        let (at, frame) = (slot as usize, &running.frames[slot as usize]);
        let (given, used_for) = ([self.given.tool, self.given.base][at], &mut self.given_for[at]);
        let wrong = |finding: CompensationFinding| self.files.source.wrong(&running.line.span, finding);
        let option = slot.option();
        match (frame, given) {
            (Ok(pose), None) => Ok(*pose),
            (Ok(pose), Some(given)) => {
                let off = (pose.position - given.position).norm() + (pose.rotation - given.rotation).norm();
                if off > SAME {
                    return Err(wrong(CompensationFinding::FrameDiffers { frame: slot.name(), option }));
                }
                Ok(*pose)
            }
            (Err(why), None) => Err(wrong(why.clone())),
            (Err(why), Some(given)) => match used_for {
                Some(before) if before != why => {
                    let (first, second) = (before.to_string(), why.to_string());
                    Err(wrong(CompensationFinding::TwoFrames { option, first, second }))
                }
                _ => {
                    *used_for = Some(why.clone());
                    Ok(given)
                }
            },
        }
    }
}
