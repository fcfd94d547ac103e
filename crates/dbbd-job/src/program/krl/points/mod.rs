//! The motions of a program made on a controller (inline forms, taught points) or by dbbd, in order, with their points and
//! frames.
//!
//! A program is corrected, not executed, so only motions and the lines that set `$TOOL` and `$BASE` matter here. The
//! text is read line by line and other statements are skipped: unlike the parser, this reader must accept any program
//! that a controller accepts.

mod frames;
mod line;

use std::collections::{HashMap, HashSet};

use self::frames::{Definitions, Effect, Frame, FrameKind, InRoutine};
use self::line::{Line, lines};
use super::data::{Constant, Constants, Origin, key};
use super::evaluate::{AXIS_NAMES, EXTERNAL_NAMES, POSE_NAMES, constant_target};
use super::statement::motion_of;
use super::syntax::{DataItem, Expression, ExpressionKind, Part, Place, Span, Text};
use crate::plan::MotionKind;
use crate::program::CompensationFinding;
use crate::program::ProgramFinding;
use crate::program::compensate::{External, external_axis_away, mixed};
use crate::program::flow::{At, Calls, Control, Followed, Follower, InForce, Ways, reached_from};
use crate::program::left_motions::LeftMotions;
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
    /// `$TOOL` in the flange frame.
    pub tool: Option<Pose>,
    /// `$BASE` in the robot base.
    pub base: Option<Pose>,
}

/// A point to which the program moves.
#[derive(Clone, Debug)]
pub struct TaughtPoint {
    /// Name of the point; `inline` if it has no name.
    pub name: String,
    /// The file that holds the numbers of the point.
    pub origin: Origin,
    /// The bytes of the point in that file.
    pub span: Span,
    /// The first statement in the `.src` that moves to the point.
    pub first_use: Span,
    /// Whether a PTP or SPTP moves to the point: only these motions obey status and turn.
    pub by_ptp: bool,
    pub target: Target,
    /// The bytes of the six numbers.
    pub numbers: [Span; 6],
    /// The bytes of the turn bits.
    pub turn: Option<Span>,
    external: External,
    /// The frames that are active at the point; `None` for axis angles.
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

impl TaughtPoint {
    /// Whether the controller corrected the arm by its own model when the point was taught (bit 4 of S).
    pub fn is_absolutely_accurate(&self) -> bool {
        const ABSOLUTELY_ACCURATE: i64 = 1 << 4;
        matches!(self.target, Target::Pose { status: Some(status), .. } if status & ABSOLUTELY_ACCURATE != 0)
    }
}

#[derive(Clone, Debug, Default)]
pub struct PointProgram {
    /// The motions, in the order of the text.
    pub motions: Vec<ProgramMotion>,
    /// The points of the program's own files, each once, in the order of their first use.
    pub points: Vec<TaughtPoint>,
    /// Uses of points that are not corrected: relative motions, points declared elsewhere, arguments of routines.
    pub not_corrected: Vec<Diagnostic>,
    /// Warnings that concern all corrections.
    pub warnings: Vec<Diagnostic>,
}

/// Largest difference (mm, or of the rotation matrix) at which a tool or base of the user is the same as the program's.
const SAME: f64 = 1e-6;

/// First words of the lines that set a frame: they use no point.
const SETTING: [&str; 4] = ["BAS", "FDAT_ACT", "SPLINE", "PTP_SPLINE"];

pub fn read(files: Files<'_>, given: Given) -> Result<PointProgram, Diagnostic> {
    let config = files.config.map(data_items).unwrap_or_default();
    let data = files.data.map(data_items).unwrap_or_default();
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
        user: UserFrames { given, used_for: [None, None] },
        definitions: Definitions { file: files.source, constants, variables },
        by_name: HashMap::new(),
        program: PointProgram::default(),
        beside: SetBeside::default(),
        named: Vec::new(),
        reached: HashSet::new(),
        reported_calls: HashSet::new(),
        frame_variables: FrameVariables::default(),
        left: LeftMotions::none(),
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

/// The points and frames of a `.dat` file of any controller; other lines are skipped, and so is what cannot be read.
fn data_items(file: Text<'_>) -> Vec<DataItem> {
    let items = lines(file).filter(|line| line.holds_structure());
    items.filter_map(|line| assignment(file, line).1).collect()
}

/// An assignment of the `.src`, with its target and value if these can be parsed.
fn assignment<'l>(file: Text<'_>, line: Line<'l>) -> (Line<'l>, Option<DataItem>) {
    let item = line.parser(file).and_then(|mut parser| parser.data_item()).ok();
    (line, item)
}

/// A routine of the file.
struct Routine<'a> {
    name: String,
    /// Whether other files may call it.
    is_global: bool,
    lines: Vec<Line<'a>>,
}

/// The routines of a file, each with its lines. Lines before the first routine are left out.
fn routines<'a>(file: Text<'a>) -> Vec<Routine<'a>> {
    let mut routines: Vec<Routine<'a>> = Vec::new();
    for line in lines(file) {
        if let Some(name) = line.routine() {
            let is_global = routines.is_empty() || line.word == "GLOBAL";
            routines.push(Routine { name, is_global, lines: Vec::new() });
        } else if let Some(routine) = routines.last_mut() {
            routine.lines.push(line);
        }
    }
    routines
}

/// The routines of a program, with the results of a first look before they are followed.
struct InFile<'a> {
    file: Text<'a>,
    routines: Vec<Routine<'a>>,
    /// The routines that each line calls, and the effect of the line; indexed by routine and line.
    calls: Calls,
    effects: Vec<Vec<Option<Effect>>>,
    /// The routines that run beside the program, each with the line that names it.
    beside: Vec<(usize, usize)>,
    set_beside: SetBeside,
}

/// The settings changed by routines that run beside the program.
#[derive(Clone, Default)]
struct SetBeside {
    /// A line that sets each frame, indexed by [`FrameKind`].
    lines: [Option<usize>; 2],
    /// Why no pose can be corrected.
    obstacle: Option<CompensationFinding>,
}

impl<'a> InFile<'a> {
    fn new(definitions: &Definitions<'a>) -> Self {
        let file = definitions.file;
        let routines = routines(file);
        let (mut calls, mut effects, mut beside) = (Vec::new(), Vec::new(), Vec::new());
        for routine in &routines {
            let (mut called_by, mut effect_of) = (Vec::new(), Vec::new());
            for line in &routine.lines {
                let index = |name: String| routines.iter().position(|routine| routine.name == name);
                let called: Vec<usize> = line.called().filter_map(index).collect();
                if line.runs_beside() {
                    let number = file.line(line.span.start);
                    beside.extend(called.iter().map(|routine| (*routine, number)));
                    called_by.push(Vec::new());
                } else {
                    called_by.push(called);
                }
                let is_motion = motion_of(&line.word).is_some() || line.is_relative_motion();
                let effect = if is_motion { None } else { definitions.effect(line) };
                let is_own = |name: &str| routines.iter().any(|routine| routine.name == name);
                effect_of.push(effect.filter(|effect| !matches!(effect, Effect::Call(name) if is_own(name))));
            }
            calls.push(called_by);
            effects.push(effect_of);
        }
        let mut program = Self { file, routines, calls, effects, beside, set_beside: SetBeside::default() };
        let named = program.beside.iter().map(|(routine, _)| *routine).collect();
        for routine in reached_from(named, &program.calls) {
            for (line, effect) in program.routines[routine].lines.iter().zip(&program.effects[routine]) {
                let mut state = InRoutine::before();
                effect.iter().for_each(|effect| state.apply(effect, file.line(line.span.start)));
                let found = &mut program.set_beside;
                found.obstacle = found.obstacle.take().or_else(|| state.obstacle());
                for (set, frame) in found.lines.iter_mut().zip(&state.frames) {
                    if !matches!(frame, InForce::One { line: 0, .. }) {
                        set.get_or_insert(file.line(line.span.start));
                    }
                }
            }
        }
        program
    }

    fn line(&self, (routine, at): At) -> &Line<'a> {
        &self.routines[routine].lines[at]
    }
}

impl Followed for InFile<'_> {
    type State = InRoutine;

    fn calls(&self, (routine, at): At) -> &[usize] {
        &self.calls[routine][at]
    }

    fn apply(&self, at: At, state: &mut InRoutine) {
        if let Some(effect) = &self.effects[at.0][at.1] {
            state.apply(effect, self.file.line(self.line(at).span.start));
        }
    }

    fn forget(&self, at: At, state: &mut InRoutine) {
        state.forget(self.file.line(self.line(at).span.start));
    }
}

/// The frames that the user gives.
struct UserFrames {
    given: Given,
    /// The reason why each frame of the user is used, indexed by [`FrameKind`]: the program's own frame is unknown for
    /// this reason.
    used_for: [Option<CompensationFinding>; 2],
}

/// The variables of frames.
#[derive(Default)]
struct FrameVariables {
    /// The names in lines that set a frame.
    set: HashSet<String>,
    /// The arguments of routines, each with the finding if it is a frame.
    given_away: Vec<(String, Diagnostic)>,
}

/// The name of a point and the index of its element; no name and the first byte of a point without one.
type PointKey = (String, Option<i64>);

struct Reader<'a> {
    files: Files<'a>,
    user: UserFrames,
    definitions: Definitions<'a>,
    /// The index of each point in the program's points: by its name, or by its bytes if it has none.
    by_name: HashMap<PointKey, usize>,
    program: PointProgram,
    beside: SetBeside,
    /// The points in statements other than motions.
    named: Vec<(String, Span)>,
    /// The lines that were reached, by their first bytes.
    reached: HashSet<usize>,
    /// The calls of other files that were reported.
    reported_calls: HashSet<String>,
    frame_variables: FrameVariables,
    left: LeftMotions<PointKey>,
}

/// The motion that is being read.
struct Current<'l> {
    line: &'l Line<'l>,
    frames: [InForce<Frame>; 2],
    /// The calls of other files since each frame was set.
    called: [Option<(String, usize)>; 2],
    /// The reason why no pose can be corrected at this motion.
    obstacle: Option<CompensationFinding>,
    by_ptp: bool,
}

impl<'a> Reader<'a> {
    fn read(mut self) -> Result<PointProgram, Diagnostic> {
        let file = self.files.source;
        check_is_krl(file)?;
        let program = InFile::new(&self.definitions);
        self.beside = program.set_beside.clone();
        let controls: Vec<Vec<Option<Control>>> = program
            .routines
            .iter()
            .map(|routine| routine.lines.iter().map(Line::control).collect())
            .collect();
        let ways: Vec<Ways> =
            controls.iter().map(|controls| Ways::new(controls.iter().map(Option::as_ref))).collect();
        let mut follower = Follower::new(&program, &ways);
        let all = 0..program.routines.len();
        for at in all.clone().filter(|at| program.routines[*at].is_global) {
            follower.visit(at, InRoutine::before(), &mut |at, state| self.line(program.line(at), state))?;
        }
        for (at, line) in &program.beside {
            let mut state = InRoutine::before();
            state.forget(*line);
            follower.visit(*at, state, &mut |at, state| self.line(program.line(at), state))?;
        }
        for at in all {
            if !follower.has_visited(at) {
                follower
                    .visit(at, InRoutine::before(), &mut |at, state| self.line(program.line(at), state))?;
            }
        }
        let lines = program.routines.iter().flat_map(|routine| &routine.lines);
        for line in lines.filter(|line| motion_of(&line.word).is_some()) {
            if !self.reached.contains(&line.span.start) {
                self.program.not_corrected.push(file.wrong(&line.span, CompensationFinding::NeverReached));
            }
        }
        self.leave_shared();
        let has_pose = self.program.points.iter().any(|point| point.frames.is_some());
        if let Some(why) = self.left.nothing_right(!self.program.points.is_empty(), has_pose) {
            return Err(why.clone());
        }
        // A point to which a motion also goes is corrected, and a frame is no point.
        let is_corrected = |name: &String| self.by_name.keys().any(|(corrected, _)| corrected == name);
        self.named.retain(|(name, _)| !is_corrected(name) && !self.frame_variables.set.contains(name));
        let in_statements = self
            .named
            .into_iter()
            .map(|(name, span)| file.wrong(&span, CompensationFinding::PointInStatement { name }));
        self.program.not_corrected.extend(in_statements);
        let is_frame = |name: &String| {
            self.frame_variables.set.contains(name) && self.definitions.constants.get((name, None)).is_some()
        };
        let given_away = self.frame_variables.given_away.into_iter().filter(|(name, _)| is_frame(name));
        self.program.warnings.extend(given_away.map(|(_, finding)| finding));
        let points = &self.program.points;
        let mut accurate = points.iter().filter(|point| point.is_absolutely_accurate());
        if let Some(TaughtPoint { name, first_use, .. }) = accurate.next() {
            let (points, name) = (1 + accurate.count(), name.clone());
            let taught = CompensationFinding::TaughtUnderAccuracy { points, name };
            self.program.warnings.push(file.wrong(first_use, taught));
        }
        let external = external_axis_away(points.iter().map(|point| (point.name.as_str(), point.external)));
        let external = external.map(|(at, finding)| file.wrong(&points[at].first_use, finding));
        self.program.warnings.extend(external);
        Ok(self.program)
    }

    /// Reads a line in one of the states that are possible before the line.
    fn line(&mut self, line: &Line<'_>, state: &InRoutine) -> Result<(), Diagnostic> {
        let is_first = self.reached.insert(line.span.start);
        if motion_of(&line.word).is_some() {
            return self.motion(line, state, is_first).or_else(|why| self.leave_motion(line, why));
        }
        if !is_first {
            return Ok(());
        }
        if line.is_relative_motion() {
            let relative = self.files.source.wrong(&line.span, CompensationFinding::RelativeMotion);
            self.program.not_corrected.push(relative);
        } else if ["$TOOL", "$BASE"].contains(&line.word.as_str()) {
            self.frame_variables.set.extend(line.words().skip(1).map(|(name, _)| name));
        } else if !SETTING.contains(&line.word.as_str()) && line.control().is_none() {
            let named = self.points_in(line);
            self.named.extend(named);
            self.note_given_away(line);
        }
        Ok(())
    }

    /// Leaves a motion as it is, with the points that it alone uses so far.
    fn leave_motion(&mut self, line: &Line<'_>, why: Diagnostic) -> Result<(), Diagnostic> {
        let file = self.files.source;
        self.program.not_corrected.extend(self.left.leave(file, &line.span, why)?);
        for (key, at) in &self.by_name {
            if self.program.points[*at].first_use == line.span {
                self.left.share(key.clone(), file.line(line.span.start));
            }
        }
        Ok(())
    }

    /// Leaves the points that motions which stay as they are use too.
    fn leave_shared(&mut self) {
        let shared: Vec<_> = self.left.shared().map(|(key, line)| (key.clone(), line)).collect();
        let mut removed = HashSet::new();
        for (key, line) in shared {
            let Some(at) = self.by_name.remove(&key) else { continue };
            let TaughtPoint { name, first_use, .. } = &self.program.points[at];
            let (name, first_use) = (name.clone(), first_use.clone());
            self.leave(&first_use, CompensationFinding::PointShared { name, line });
            removed.insert(at);
        }
        let kept: Vec<usize> = (0..self.program.points.len()).filter(|at| !removed.contains(at)).collect();
        let moved = |at: &usize| kept.binary_search(at).ok();
        for motion in &mut self.program.motions {
            motion.through = motion.through.iter().filter_map(moved).collect();
            motion.to = motion.to.iter().filter_map(moved).collect();
        }
        self.by_name.values_mut().for_each(|at| *at = moved(at).unwrap_or_default());
        self.program.points = kept.iter().map(|at| self.program.points[*at].clone()).collect();
    }

    /// Notes the variables that are passed to a routine, which may change them.
    fn note_given_away(&mut self, line: &Line<'_>) {
        if !line.is_call() {
            return;
        }
        for (name, span) in line.words().skip(1) {
            let routine = line.word.clone();
            let given_away = CompensationFinding::FrameGivenAway { name: name.clone(), routine };
            self.frame_variables.given_away.push((name, self.files.source.wrong(&span, given_away)));
        }
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

    /// Adds a motion.
    fn motion(&mut self, line: &Line<'_>, state: &InRoutine, is_first: bool) -> Result<(), Diagnostic> {
        let mut parser = line.parser(self.files.source)?;
        let mut motion = parser.motion()?;
        if matches!(parser.tokens.peek(), Token::Sign(":")) {
            return Err(self.files.source.wrong(&line.span, CompensationFinding::PointExpression));
        }
        motion.angle = parser.angle()?;
        let with = self.definitions.with(&mut parser)?;
        let mut called = state.called.clone();
        for (called, _) in called.iter_mut().zip(&with).filter(|(_, with)| with.is_some()) {
            *called = None;
        }
        let frames = state.with(with, self.files.source.line(line.span.start));
        let by_ptp = motion.motion == MotionKind::Ptp;
        let obstacle = self.beside.obstacle.clone().or_else(|| state.obstacle());
        let current = Current { line, frames, called, obstacle, by_ptp };
        let through = match &motion.through {
            Some(through) => self.target(through, &current)?,
            None => Vec::new(),
        };
        let to = self.target(&motion.to, &current)?;
        let sweep_deg = motion.angle.and_then(|angle| angle.constant().ok()?.number().ok());
        if is_first {
            self.program.motions.push(ProgramMotion { motion: motion.motion, through, to, sweep_deg });
        }
        Ok(())
    }

    /// Adds the point or points that a target may mean, and returns their indices.
    fn target(&mut self, target: &Expression, current: &Current<'_>) -> Result<Vec<usize>, Diagnostic> {
        let file = self.files.source;
        let place = match &target.kind {
            ExpressionKind::Aggregate(_) => {
                let inline = Constant { value: target, origin: Origin::Source };
                let point = self.point("inline", inline, current)?;
                let key = (String::new(), i64::try_from(target.span.start).ok());
                return Ok(vec![self.add(key, point, &target.span)?]);
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
            self.leave(&place.span, elsewhere);
        }
        Ok(indices)
    }

    /// Adds a named point, unless it must not be rewritten (home positions, `$config.dat`), and returns its index.
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
        let key = (place.name.clone(), element);
        let point = self.point(&name, constant, current);
        let added = point.and_then(|point| self.add(key.clone(), point, &place.span));
        if added.is_err() {
            self.left.share(key, self.files.source.line(current.line.span.start));
        }
        added.map(Some)
    }

    /// Adds a point that a motion uses at `span`, unless it is known, and returns its index.
    fn add(
        &mut self,
        key: (String, Option<i64>),
        point: TaughtPoint,
        span: &Span,
    ) -> Result<usize, Diagnostic> {
        let points = &mut self.program.points;
        let at = *self.by_name.entry(key).or_insert(points.len());
        match points.get_mut(at) {
            None => points.push(point),
            Some(known) if known.frames == point.frames => known.by_ptp |= point.by_ptp,
            Some(known) => {
                let line = self.files.source.line(known.first_use.start);
                let twice = CompensationFinding::PointTwice { name: point.name, line };
                return Err(self.files.source.wrong(span, twice));
            }
        }
        Ok(at)
    }

    /// Adds a finding about a point that is not corrected, once for each place.
    fn leave(&mut self, span: &Span, why: CompensationFinding) {
        let left = self.files.source.wrong(span, why);
        if !self.program.not_corrected.contains(&left) {
            self.program.not_corrected.push(left);
        }
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
                if let Some(obstacle) = &current.obstacle {
                    return Err(self.files.source.wrong(&current.line.span, obstacle.clone()));
                }
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
        let at = kind as usize;
        let wrong = |finding: CompensationFinding| self.files.source.wrong(&current.line.span, finding);
        let active = match &current.frames[at] {
            InForce::One { value, .. } => value,
            InForce::Mixed(lines) => return Err(wrong(mixed(kind.name(), *lines))),
        };
        if let Some(line) = self.beside.lines[at] {
            return Err(wrong(CompensationFinding::FrameBeside { frame: kind.name(), line }));
        }
        if let Some((routine, line)) = &current.called[at]
            && self.reported_calls.insert(routine.clone())
        {
            let (frame, routine) = (kind.name(), routine.clone());
            let after = wrong(CompensationFinding::FrameAfterCall { frame, routine, line: *line });
            self.program.warnings.push(after);
        }
        let UserFrames { given, used_for } = &mut self.user;
        let (given, used_for) = ([given.tool, given.base][at], &mut used_for[at]);
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
            // A fixed frame cannot replace a frame that a mechanical unit moves.
            (Err(why @ CompensationFinding::MovedWorkObject { .. }), _) | (Err(why), None) => {
                Err(wrong(why.clone()))
            }
            (Err(why), Some(given)) => match used_for {
                Some(before) if before != why => {
                    let (first, second) = (before.to_string(), why.to_string());
                    Err(wrong(CompensationFinding::TwoFrames { stated, first, second }))
                }
                _ => {
                    *used_for = Some(why.clone());
                    Ok(given)
                }
            },
        }
    }
}
