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
    /// `FDAT_ACT.TOOL_NO` or `FDAT_ACT.BASE_NO`.
    FrameDataPart(FrameKind, Frame),
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
                // Where neither frame is known, nor is the mode: one that was in force remains.
                if frames.iter().any(Result::is_ok) {
                    self.obstacles[Obstacle::Mode as usize] = InForce::One { value: None, line };
                }
            }
            Effect::FrameDataPart(kind, value) => {
                self.set(*kind, value.clone(), line);
                if let InForce::One { value: frames, line: set } = &mut self.frame_data {
                    let not_set = || unknown(|frame| CompensationFinding::FrameNotSet { frame });
                    frames.get_or_insert_with(not_set)[*kind as usize] = value.clone();
                    *set = line;
                }
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
    /// The effect of a line that is no motion; `None` if it sets nothing that matters here. A line that cannot be read leaves its
    /// frames unknown.
    pub(super) fn effect(&self, line: &Line<'_>) -> Option<Effect> {
        let computed = |kind: FrameKind| self.computed(kind, &line.span);
        let frame = |kind| Effect::Frame(kind, self.assigned(kind, line).unwrap_or_else(|_| computed(kind)));
        Some(match line.word.as_str() {
            "$TOOL" => frame(FrameKind::Tool),
            "$BASE" => frame(FrameKind::Base),
            "BAS" => {
                let unread = |_| Some(Effect::FrameData([FrameKind::Tool, FrameKind::Base].map(computed)));
                return self.bas(line).unwrap_or_else(unread);
            }
            "FDAT_ACT" => {
                let unread = |_| Some(Effect::FrameData([FrameKind::Tool, FrameKind::Base].map(computed)));
                return self.frame_data_assigned(line).unwrap_or_else(unread);
            }
            "$IPO_MODE" => self.obstacle(Obstacle::Mode, line, "#BASE"),
            "$ABS_ACCUR" => self.obstacle(Obstacle::Accuracy, line, "FALSE"),
            "$SUPPRESS_ABS_ACCUR" | "$DEACTIVATE_ABS_ACCUR" => {
                self.obstacle(Obstacle::Accuracy, line, "TRUE")
            }
            "$ROBROOT" => self.obstacle(Obstacle::Root, line, "$NULLFRAME"),
            "SPLINE" | "PTP_SPLINE" => {
                let with = line.parser(self.file).and_then(|mut parser| self.with(&mut parser));
                let unread = |_| [FrameKind::Tool, FrameKind::Base].map(|kind| Some(computed(kind)));
                Effect::Spline(with.unwrap_or_else(unread))
            }
            "ENDSPLINE" => Effect::EndSpline,
            word if line.is_call() && !HARMLESS.iter().any(|start| word.starts_with(start)) => {
                Effect::Call(word.to_owned())
            }
            _ => return None,
        })
    }

    /// `FDAT_ACT=FP1`, `FDAT_ACT={TOOL_NO 1,BASE_NO 0,IPO_FRAME #BASE}` or `FDAT_ACT.TOOL_NO=1`.
    fn frame_data_assigned(&self, line: &Line<'_>) -> Result<Option<Effect>, Diagnostic> {
        let mut parser = line.parser(self.file)?;
        parser.tokens.advance();
        if parser.tokens.accept(".") {
            let (component, _) = parser.name()?;
            parser.tokens.expect("=")?;
            let value = parser.expression()?;
            let numbered = |kind| {
                let number = value.index();
                number.map_or_else(|| self.computed(kind, &value.span), |number| self.numbered(kind, number))
            };
            return Ok(match component.as_str() {
                "TOOL_NO" => Some(Effect::FrameDataPart(FrameKind::Tool, numbered(FrameKind::Tool))),
                "BASE_NO" => Some(Effect::FrameDataPart(FrameKind::Base, numbered(FrameKind::Base))),
                "IPO_FRAME" => Some(self.obstacle(Obstacle::Mode, line, "#BASE")),
                _ => None,
            });
        }
        parser.tokens.expect("=")?;
        let value = parser.expression()?;
        Ok(Some(Effect::FrameData(self.frame_data_value(&value))))
    }

    /// The frames of an FDAT; those of an element of an array are computed.
    fn frame_data_value(&self, value: &Expression) -> [Frame; 2] {
        match &value.kind {
            ExpressionKind::Aggregate(_) => self.frame_data_of(value, "FDAT_ACT"),
            ExpressionKind::Place(place) if place.parts.is_empty() => self.frame_data(&place.name),
            ExpressionKind::Place(_)
            | ExpressionKind::Int(_)
            | ExpressionKind::Real(_)
            | ExpressionKind::Bool(_)
            | ExpressionKind::Enum(_)
            | ExpressionKind::Text(_)
            | ExpressionKind::Call { .. }
            | ExpressionKind::Unary(..)
            | ExpressionKind::Binary(..) => {
                [FrameKind::Tool, FrameKind::Base].map(|kind| self.computed(kind, &value.span))
            }
        }
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
        // A command that is computed may set either frame.
        let Token::Enum(command) = parser.tokens.peek().clone() else {
            return Err(parser.tokens.expected("a command"));
        };
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
            Some(number) => self.numbered(kind, number),
            None => self.computed(kind, &index.span),
        };
        Ok(Some(Effect::Frame(kind, frame)))
    }

    /// `WITH $TOOL=..` after a spline motion: frames for this motion only.
    pub(super) fn with(&self, parser: &mut Parser<'_>) -> Result<[Option<Frame>; 2], Diagnostic> {
        let mut frames: [Option<Frame>; 2] = [None, None];
        while !parser.tokens.is_line_end() {
            let kind = [FrameKind::Tool, FrameKind::Base]
                .into_iter()
                .find(|kind| parser.tokens.is_name(kind.name()));
            let is_mode = parser.tokens.is_name(Obstacle::Mode.name());
            parser.tokens.advance();
            if (kind.is_none() && !is_mode) || !parser.tokens.accept("=") {
                continue;
            }
            if let Some(kind) = kind {
                frames[kind as usize] = Some(self.value(kind, parser)?);
            } else if matches!(parser.tokens.peek(), Token::Enum(mode) if mode != "BASE") {
                return Ok(unknown(|_| CompensationFinding::FixedTool { name: "$IPO_MODE".into() }).map(Some));
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
            ExpressionKind::Aggregate(_) => Ok(known(&expression, kind.name())),
            ExpressionKind::Place(place) if place.name == "$NULLFRAME" => Ok(Ok(Pose::identity())),
            ExpressionKind::Place(place) => Ok(self.named(kind, place)),
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
        let (frame_data, _) = parser.name()?;
        let [tool, base] = self.frame_data(&frame_data);
        while !parser.tokens.accept(")") {
            if parser.tokens.is_line_end() {
                return Err(parser.tokens.expected("`)`"));
            }
            parser.tokens.advance();
        }
        Ok(if function == "SBASE" { base } else { tool })
    }

    /// The frame of a variable.
    fn named(&self, kind: FrameKind, place: &Place) -> Frame {
        let Some(key) = key(place) else { return self.computed(kind, &place.span) };
        if let (array @ ("TOOL_DATA" | "BASE_DATA"), Some(index)) = key {
            let kind = if array == "TOOL_DATA" { FrameKind::Tool } else { FrameKind::Base };
            return self.numbered(kind, index);
        }
        if let Some(assignment) = self.variables.get(key.0) {
            return self.computed(kind, assignment);
        }
        match self.constants.get(key) {
            Some(constant) => known(constant.value, key.0),
            None => {
                let name = place.name.clone();
                Err(CompensationFinding::FrameElsewhere { frame: kind.name(), name })
            }
        }
    }

    /// `TOOL_DATA[n]`, `BASE_DATA[n]`; number 0 is the null frame.
    fn numbered(&self, kind: FrameKind, index: i64) -> Frame {
        if index == 0 {
            return Ok(Pose::identity());
        }
        if let Some(assignment) = self.variables.get(kind.array()) {
            return self.computed(kind, assignment);
        }
        let name = format!("{}[{index}]", kind.array());
        match self.constants.get((kind.array(), Some(index))) {
            Some(constant) if constant.origin != Origin::Source => known(constant.value, &name),
            _ => Err(CompensationFinding::FrameElsewhere { frame: kind.name(), name }),
        }
    }

    /// The frames of an FDAT, which belongs to the point of an inline form.
    fn frame_data(&self, name: &str) -> [Frame; 2] {
        if let Some(assignment) = self.variables.get(name) {
            return [FrameKind::Tool, FrameKind::Base].map(|kind| self.computed(kind, assignment));
        }
        match self.constants.get((name, None)) {
            Some(constant) => self.frame_data_of(constant.value, name),
            None => unknown(|frame| CompensationFinding::FrameElsewhere { frame, name: name.into() }),
        }
    }

    /// The frames of the aggregate of an FDAT.
    fn frame_data_of(&self, value: &Expression, name: &str) -> [Frame; 2] {
        let wrong = |why: &str| CompensationFinding::PointIncomplete { name: name.into(), why: why.into() };
        let ExpressionKind::Aggregate(fields) = &value.kind else {
            return unknown(|_| wrong("this is not an FDAT"));
        };
        let component = |name: &str| fields.iter().find(|field| field.name == name);
        let mode = component("IPO_FRAME").map(|field| &field.value.kind);
        if matches!(mode, Some(ExpressionKind::Enum(mode)) if mode != "BASE") {
            return unknown(|_| CompensationFinding::FixedTool { name: name.into() });
        }
        [(FrameKind::Tool, "TOOL_NO"), (FrameKind::Base, "BASE_NO")].map(|(kind, number)| {
            let index = component(number).and_then(|field| field.value.index());
            let index = index.ok_or_else(|| wrong(&format!("{number} is missing")))?;
            self.numbered(kind, index)
        })
    }
}

/// The frame of a constant.
fn known(value: &Expression, name: &str) -> Frame {
    let why = match constant_target(value) {
        Ok(Target::Pose { xyz_mm, abc_deg, .. }) => return Ok(Pose::from_kuka(xyz_mm, abc_deg)),
        Ok(Target::Axes(_)) => "these are axis angles".into(),
        Err(fault) => fault.finding.to_string(),
    };
    Err(CompensationFinding::PointIncomplete { name: name.into(), why })
}
