//! The values of `$TOOL` and `$BASE` at each motion, and the other settings on which its place depends.

use std::collections::HashMap;

use super::line::Line;
use crate::program::CompensationFinding;
use crate::program::Target;
use crate::program::compensate::mixed;
use crate::program::flow::{InForce, State};
use crate::program::krl::data::{Constants, Origin, key};
use crate::program::krl::evaluate::constant_target;
use crate::program::krl::parser::Parser;
use crate::program::krl::syntax::{Expression, ExpressionKind, Place, Span, Text};
use crate::program::lexer::Token;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::Pose;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FrameKind {
    Tool,
    Base,
}

impl FrameKind {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Tool => "$TOOL",
            Self::Base => "$BASE",
        }
    }

    pub(super) fn stated(self) -> &'static str {
        match self {
            Self::Tool => "the given tool",
            Self::Base => "the given base",
        }
    }

    /// The array in `$config.dat`.
    fn array(self) -> &'static str {
        match self {
            Self::Tool => "TOOL_DATA",
            Self::Base => "BASE_DATA",
        }
    }
}

/// A frame, or why it is unknown. Frames that are unknown for the same reason are taken for one frame.
pub(super) type Frame = Result<Pose, CompensationFinding>;

/// Both frames unknown, for the same reason.
fn unknown(why: impl Fn(&'static str) -> CompensationFinding) -> [Frame; 2] {
    [FrameKind::Tool, FrameKind::Base].map(|kind| Err(why(kind.name())))
}

/// A setting with which the controller does not move by the frames alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Obstacle {
    /// `$IPO_MODE=#TCP`: the tool is fixed.
    Mode,
    /// The controller corrects poses by itself.
    Accuracy,
    /// The robot's base is not the origin of `$BASE`.
    Root,
}

impl Obstacle {
    const ALL: [Self; 3] = [Self::Mode, Self::Accuracy, Self::Root];

    fn name(self) -> &'static str {
        match self {
            Self::Mode => "$IPO_MODE",
            Self::Accuracy => "$ABS_ACCUR",
            Self::Root => "$ROBROOT",
        }
    }
}

/// The effect of a line on the settings in force.
#[derive(Clone, Debug)]
pub(super) enum Effect {
    Frame(FrameKind, Frame),
    /// `FDAT_ACT`: both frames, which `BAS (#PTP_PARAMS, ..)` and its like set again.
    FrameData([Frame; 2]),
    SetFrameData,
    Obstacle(Obstacle, Option<CompensationFinding>),
    /// `SPLINE` with the frames of its `WITH`.
    Spline([Option<Frame>; 2]),
    EndSpline,
    /// A call of a routine of another file.
    Call(String),
}

/// A call of a routine of another file, with its line.
type Called = Option<(String, usize)>;

/// The settings in force at a line.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct InRoutine {
    /// `$TOOL` and `$BASE`, indexed by [`FrameKind`].
    pub(super) frames: [InForce<Frame>; 2],
    /// The first call of another file since each frame was set, indexed by [`FrameKind`].
    pub(super) called: [Called; 2],
    frame_data: InForce<Option<[Frame; 2]>>,
    /// The frames of a spline block.
    spline: Option<[InForce<Frame>; 2]>,
    /// The obstacles, indexed by [`Obstacle`].
    obstacles: [InForce<Option<CompensationFinding>>; 3],
}

impl InRoutine {
    /// The settings at the begin of a routine that is called from elsewhere.
    pub(super) fn before() -> Self {
        let none = || InForce::One { value: None, line: 0 };
        Self {
            frames: unknown(|frame| CompensationFinding::FrameNotSet { frame })
                .map(|value| InForce::One { value, line: 0 }),
            called: [None, None],
            frame_data: InForce::One { value: None, line: 0 },
            spline: None,
            obstacles: [none(), none(), none()],
        }
    }

    /// The frames of the motions at this line.
    pub(super) fn active(&self) -> &[InForce<Frame>; 2] {
        self.spline.as_ref().unwrap_or(&self.frames)
    }

    /// The reason why no pose can be corrected at this line.
    pub(super) fn obstacle(&self) -> Option<CompensationFinding> {
        Obstacle::ALL.iter().zip(&self.obstacles).find_map(|(obstacle, in_force)| match in_force {
            InForce::One { value, .. } => value.clone(),
            InForce::Mixed(lines) => Some(mixed(obstacle.name(), *lines)),
        })
    }

    pub(super) fn forget(&mut self, line: usize) {
        self.frames.iter_mut().for_each(|frame| frame.forget(line));
        self.frame_data.forget(line);
        self.obstacles.iter_mut().for_each(|obstacle| obstacle.forget(line));
        self.spline = None;
    }

    fn set(&mut self, kind: FrameKind, value: Frame, line: usize) {
        self.frames[kind as usize] = InForce::One { value, line };
        self.called[kind as usize] = None;
    }

    fn set_both(&mut self, [tool, base]: [Frame; 2], line: usize) {
        self.set(FrameKind::Tool, tool, line);
        self.set(FrameKind::Base, base, line);
    }

    /// Applies the effect of a line.
    pub(super) fn apply(&mut self, effect: &Effect, line: usize) {
        match effect {
            Effect::Frame(kind, value) => self.set(*kind, value.clone(), line),
            Effect::FrameData(frames) => {
                self.set_both(frames.clone(), line);
                self.frame_data = InForce::One { value: Some(frames.clone()), line };
                self.obstacles[Obstacle::Mode as usize] = InForce::One { value: None, line };
            }
            Effect::SetFrameData => match &self.frame_data {
                InForce::One { value: Some(frames), line } => self.set_both(frames.clone(), *line),
                InForce::One { value: None, .. } => {}
                InForce::Mixed(lines) => self.frames = [InForce::Mixed(*lines), InForce::Mixed(*lines)],
            },
            Effect::Obstacle(obstacle, value) => {
                self.obstacles[*obstacle as usize] = InForce::One { value: value.clone(), line };
            }
            Effect::Spline(with) => self.spline = Some(self.with(with.clone(), line)),
            Effect::EndSpline => self.spline = None,
            Effect::Call(routine) => {
                for called in &mut self.called {
                    called.get_or_insert_with(|| (routine.clone(), line));
                }
            }
        }
    }

    /// The frames of a motion: the frames of its `WITH`, else the active ones.
    pub(super) fn with(&self, with: [Option<Frame>; 2], line: usize) -> [InForce<Frame>; 2] {
        let [tool, base] = self.active().clone();
        let [with_tool, with_base] = with.map(|with| with.map(|value| InForce::One { value, line }));
        [with_tool.unwrap_or(tool), with_base.unwrap_or(base)]
    }
}

impl State for InRoutine {
    fn join(&mut self, other: &Self) {
        let frames = self.frames.iter_mut().zip(&other.frames);
        frames.for_each(|(known, other)| known.join(other));
        for (known, other) in self.called.iter_mut().zip(&other.called) {
            *known = known.take().or_else(|| other.clone());
        }
        self.frame_data.join(&other.frame_data);
        if self.spline != other.spline {
            self.spline = None;
        }
        let obstacles = self.obstacles.iter_mut().zip(&other.obstacles);
        obstacles.for_each(|(known, other)| known.join(other));
    }
}

/// Starts of the names of routines of the controller and its options that do not change the frames.
const HARMLESS: &[&str] = &[
    "CWRITE", "CREAD", "COPEN", "CCLOSE", "SREAD", "SWRITE", "CAST_", "MBX_", "EKI_", "CLEAR", "CANCEL",
    "SYNC", "PULSE", "LOCK", "UNLOCK",
];

/// The values of the names in a program.
pub(super) struct Definitions<'a> {
    pub(super) file: Text<'a>,
    pub(super) constants: Constants<'a>,
    /// The names to which the `.src` assigns a computed value or a second value, with that assignment.
    pub(super) variables: HashMap<String, Span>,
}

impl Definitions<'_> {
    /// The effect of a line that is no motion; `None` if it sets nothing that matters here.
    pub(super) fn effect(&self, line: &Line<'_>) -> Result<Option<Effect>, Diagnostic> {
        Ok(Some(match line.word.as_str() {
            "$TOOL" => Effect::Frame(FrameKind::Tool, self.assigned(FrameKind::Tool, line)?),
            "$BASE" => Effect::Frame(FrameKind::Base, self.assigned(FrameKind::Base, line)?),
            "BAS" => return self.bas(line),
            "FDAT_ACT" => {
                let mut parser = line.parser(self.file)?;
                parser.tokens.advance();
                parser.tokens.expect("=")?;
                let (name, span) = parser.name()?;
                Effect::FrameData(self.frame_data(&name, &span)?)
            }
            "$IPO_MODE" => self.obstacle(Obstacle::Mode, line, "#BASE"),
            "$ABS_ACCUR" => self.obstacle(Obstacle::Accuracy, line, "FALSE"),
            "$DEACTIVATE_ABS_ACCUR" => self.obstacle(Obstacle::Accuracy, line, "TRUE"),
            "$ROBROOT" => self.obstacle(Obstacle::Root, line, "$NULLFRAME"),
            "SPLINE" | "PTP_SPLINE" => Effect::Spline(self.with(&mut line.parser(self.file)?)?),
            "ENDSPLINE" => Effect::EndSpline,
            word if line.is_call() && !HARMLESS.iter().any(|start| word.starts_with(start)) => {
                Effect::Call(word.to_owned())
            }
            _ => return Ok(None),
        }))
    }

    /// The effect of a line that sets an obstacle; `without` is the value that removes the obstacle.
    fn obstacle(&self, obstacle: Obstacle, line: &Line<'_>, without: &str) -> Effect {
        let code = line.code().to_ascii_uppercase();
        let value = code.split_once('=').map_or("", |(_, value)| value.trim());
        let number = self.file.line(line.span.start);
        let why = match obstacle {
            Obstacle::Mode => CompensationFinding::FixedTool { name: format!("$IPO_MODE of line {number}") },
            Obstacle::Accuracy => CompensationFinding::ControllerCorrects { line: number },
            Obstacle::Root => CompensationFinding::RootSet { line: number },
        };
        Effect::Obstacle(obstacle, (value != without).then_some(why))
    }

    /// `$TOOL=..` or `$BASE=..`
    fn assigned(&self, kind: FrameKind, line: &Line<'_>) -> Result<Frame, Diagnostic> {
        let mut parser = line.parser(self.file)?;
        parser.tokens.advance();
        if !parser.tokens.accept("=") {
            let line = self.file.line(line.span.start);
            return Ok(Err(CompensationFinding::FramePart { frame: kind.name(), line }));
        }
        self.value(kind, &mut parser)
    }

    /// `BAS (#TOOL,1)`
    fn bas(&self, line: &Line<'_>) -> Result<Option<Effect>, Diagnostic> {
        let mut parser = line.parser(self.file)?;
        parser.tokens.advance();
        parser.tokens.expect("(")?;
        let Token::Enum(command) = parser.tokens.peek().clone() else { return Ok(None) };
        let kind = match command.as_str() {
            "TOOL" => FrameKind::Tool,
            "BASE" | "EX_BASE" => FrameKind::Base,
            // The frames that INITMOV sets depend on the version of the controller.
            "INITMOV" => {
                let not_set = unknown(|frame| CompensationFinding::FrameNotSet { frame });
                return Ok(Some(Effect::FrameData(not_set)));
            }
            "FRAMES" | "PTP_PARAMS" | "CP_PARAMS" => return Ok(Some(Effect::SetFrameData)),
            _ => return Ok(None),
        };
        parser.tokens.advance();
        parser.tokens.expect(",")?;
        let index = parser.expression()?;
        let frame = match index.index() {
            Some(number) if command == "EX_BASE" => {
                Err(CompensationFinding::MovedWorkObject { name: format!("EX_BASE {number}") })
            }
            Some(number) => self.numbered(kind, number, &index.span)?,
            None => self.computed(kind, &index.span),
        };
        Ok(Some(Effect::Frame(kind, frame)))
    }

    /// `WITH $TOOL=..` after a spline motion: frames for this motion only.
    pub(super) fn with(&self, parser: &mut Parser<'_>) -> Result<[Option<Frame>; 2], Diagnostic> {
        let mut frames = [None, None];
        while !parser.tokens.is_line_end() {
            let kind = [FrameKind::Tool, FrameKind::Base]
                .into_iter()
                .find(|kind| parser.tokens.is_name(kind.name()));
            let is_mode = parser.tokens.is_name(Obstacle::Mode.name());
            let span = parser.tokens.span();
            parser.tokens.advance();
            if (kind.is_none() && !is_mode) || !parser.tokens.accept("=") {
                continue;
            }
            if let Some(kind) = kind {
                frames[kind as usize] = Some(self.value(kind, parser)?);
            } else if matches!(parser.tokens.peek(), Token::Enum(mode) if mode != "BASE") {
                return Err(self
                    .file
                    .wrong(&span, CompensationFinding::FixedTool { name: "$IPO_MODE".into() }));
            }
        }
        Ok(frames)
    }

    fn computed(&self, kind: FrameKind, span: &Span) -> Frame {
        let line = self.file.line(span.start);
        Err(CompensationFinding::FrameComputed { frame: kind.name(), line })
    }

    /// The frame after `$TOOL=` or `$BASE=`.
    fn value(&self, kind: FrameKind, parser: &mut Parser<'_>) -> Result<Frame, Diagnostic> {
        if let (Token::Name(name), Token::Sign("(")) = (parser.tokens.peek().clone(), parser.tokens.ahead(1))
        {
            return self.inline_form(kind, &name, parser);
        }
        let expression = parser.expression()?;
        if matches!(parser.tokens.peek(), Token::Sign(":")) {
            return Ok(self.computed(kind, &expression.span));
        }
        match &expression.kind {
            ExpressionKind::Aggregate(_) => self.known(&expression, kind.name(), &expression.span).map(Ok),
            ExpressionKind::Place(place) if place.name == "$NULLFRAME" => Ok(Ok(Pose::identity())),
            ExpressionKind::Place(place) => self.named(kind, place),
            ExpressionKind::Int(_)
            | ExpressionKind::Real(_)
            | ExpressionKind::Bool(_)
            | ExpressionKind::Enum(_)
            | ExpressionKind::Text(_)
            | ExpressionKind::Call { .. }
            | ExpressionKind::Unary(..)
            | ExpressionKind::Binary(..) => Ok(self.computed(kind, &expression.span)),
        }
    }

    /// Functions of KUKA's inline forms: `STOOL2(FP1)`, `SBASE(FP1.BASE_NO)`.
    fn inline_form(
        &self,
        kind: FrameKind,
        function: &str,
        parser: &mut Parser<'_>,
    ) -> Result<Frame, Diagnostic> {
        let start = parser.tokens.span();
        parser.tokens.advance();
        parser.tokens.advance();
        if !matches!(function, "STOOL" | "STOOL2" | "SBASE") {
            return Ok(self.computed(kind, &start));
        }
        let (frame_data, span) = parser.name()?;
        let [tool, base] = self.frame_data(&frame_data, &span)?;
        while !parser.tokens.accept(")") {
            if parser.tokens.is_line_end() {
                return Err(parser.tokens.expected("`)`"));
            }
            parser.tokens.advance();
        }
        Ok(if function == "SBASE" { base } else { tool })
    }

    /// The frame of a variable.
    fn named(&self, kind: FrameKind, place: &Place) -> Result<Frame, Diagnostic> {
        let Some(key) = key(place) else { return Ok(self.computed(kind, &place.span)) };
        if let (array @ ("TOOL_DATA" | "BASE_DATA"), Some(index)) = key {
            let kind = if array == "TOOL_DATA" { FrameKind::Tool } else { FrameKind::Base };
            return self.numbered(kind, index, &place.span);
        }
        if let Some(assignment) = self.variables.get(key.0) {
            return Ok(self.computed(kind, assignment));
        }
        match self.constants.get(key) {
            Some(constant) => self.known(constant.value, key.0, &place.span).map(Ok),
            None => {
                let name = place.name.clone();
                Ok(Err(CompensationFinding::FrameElsewhere { frame: kind.name(), name }))
            }
        }
    }

    /// The frame of a constant; an error is reported at `span`, where the constant is used.
    fn known(&self, value: &Expression, name: &str, span: &Span) -> Result<Pose, Diagnostic> {
        let why = match constant_target(value) {
            Ok(Target::Pose { xyz_mm, abc_deg, .. }) => return Ok(Pose::from_kuka(xyz_mm, abc_deg)),
            Ok(Target::Axes(_)) => "these are axis angles".into(),
            Err(fault) => fault.finding.to_string(),
        };
        Err(self.file.wrong(span, CompensationFinding::PointIncomplete { name: name.into(), why }))
    }

    /// `TOOL_DATA[n]`, `BASE_DATA[n]`; number 0 is the null frame.
    fn numbered(&self, kind: FrameKind, index: i64, span: &Span) -> Result<Frame, Diagnostic> {
        if index == 0 {
            return Ok(Ok(Pose::identity()));
        }
        if let Some(assignment) = self.variables.get(kind.array()) {
            return Ok(self.computed(kind, assignment));
        }
        let name = format!("{}[{index}]", kind.array());
        match self.constants.get((kind.array(), Some(index))) {
            Some(constant) if constant.origin != Origin::Source => {
                self.known(constant.value, &name, span).map(Ok)
            }
            _ => Ok(Err(CompensationFinding::FrameElsewhere { frame: kind.name(), name })),
        }
    }

    /// The frames of an FDAT, which belongs to the point of an inline form.
    fn frame_data(&self, name: &str, span: &Span) -> Result<[Frame; 2], Diagnostic> {
        if let Some(assignment) = self.variables.get(name) {
            return Ok([FrameKind::Tool, FrameKind::Base].map(|kind| self.computed(kind, assignment)));
        }
        let Some(constant) = self.constants.get((name, None)) else {
            return Ok(unknown(|frame| CompensationFinding::FrameElsewhere { frame, name: name.into() }));
        };
        let wrong = |why: String| {
            self.file.wrong(span, CompensationFinding::PointIncomplete { name: name.into(), why })
        };
        let ExpressionKind::Aggregate(fields) = &constant.value.kind else {
            return Err(wrong("this is not an FDAT".into()));
        };
        let component = |name: &str| fields.iter().find(|field| field.name == name);
        let mode = component("IPO_FRAME").map(|field| &field.value.kind);
        if matches!(mode, Some(ExpressionKind::Enum(mode)) if mode != "BASE") {
            return Err(self.file.wrong(span, CompensationFinding::FixedTool { name: name.into() }));
        }
        let number = |name: &str| {
            let index = component(name).and_then(|field| field.value.index());
            index.ok_or_else(|| wrong(format!("{name} is missing")))
        };
        let tool = self.numbered(FrameKind::Tool, number("TOOL_NO")?, span)?;
        Ok([tool, self.numbered(FrameKind::Base, number("BASE_NO")?, span)?])
    }
}
