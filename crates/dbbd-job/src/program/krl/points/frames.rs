//! The values of `$TOOL` and `$BASE` at each motion.
//!
//! They are tracked down the text. If the branches of an IF or SWITCH leave them different, they are unknown after it. If a
//! loop changes them, a motion in the loop before the change would run under both values, which is refused.

use std::collections::HashMap;

use super::line::Line;
use crate::program::CompensationFinding;
use crate::program::Target;
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
type Frame = Result<Pose, CompensationFinding>;

/// `$TOOL` and `$BASE`, by [`FrameKind`].
pub(super) type ActiveFrames = [Frame; 2];

/// Both unknown, for the same reason.
pub(super) fn unknown(why: impl Fn(&'static str) -> CompensationFinding) -> ActiveFrames {
    [FrameKind::Tool, FrameKind::Base].map(|kind| Err(why(kind.name())))
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum BlockKind {
    /// IF or SWITCH.
    Branch,
    Loop,
}

/// A block that is open.
struct Block {
    kind: BlockKind,
    /// The frames before the block.
    before: ActiveFrames,
    /// Whether an earlier branch changed the frames.
    changed: bool,
    /// The first motion in the block that runs under the frames from before it.
    first_use: Option<Span>,
}

/// Tracks the frames through the control flow of a routine.
pub(super) struct FrameTracker {
    pub(super) active: ActiveFrames,
    open: Vec<Block>,
}

impl FrameTracker {
    pub(super) fn new() -> Self {
        Self { active: unknown(|frame| CompensationFinding::FrameNotSet { frame }), open: Vec::new() }
    }

    /// Notes that a motion runs under the active frames.
    pub(super) fn note_use(&mut self, span: &Span) {
        for block in self.open.iter_mut().filter(|block| block.before == self.active) {
            block.first_use.get_or_insert_with(|| span.clone());
        }
    }

    /// Tracks a line of control flow; `false` if it is another statement.
    pub(super) fn control_flow(&mut self, file: Text<'_>, line: &Line<'_>) -> Result<bool, Diagnostic> {
        match line.word.as_str() {
            "IF" | "SWITCH" => self.open(BlockKind::Branch),
            "FOR" | "WHILE" | "LOOP" | "REPEAT" => self.open(BlockKind::Loop),
            "ELSE" | "CASE" | "DEFAULT" => {
                if let Some(block) = self.open.last_mut() {
                    block.changed |= self.active != block.before;
                    self.active = block.before.clone();
                }
            }
            "ENDIF" | "ENDSWITCH" | "ENDFOR" | "ENDWHILE" | "ENDLOOP" | "UNTIL" => self.close(file, line)?,
            _ => return Ok(false),
        }
        Ok(true)
    }

    fn open(&mut self, kind: BlockKind) {
        self.open.push(Block { kind, before: self.active.clone(), changed: false, first_use: None });
    }

    fn close(&mut self, file: Text<'_>, line: &Line<'_>) -> Result<(), Diagnostic> {
        let Some(block) = self.open.pop() else { return Ok(()) };
        if !block.changed && self.active == block.before {
            return Ok(());
        }
        if block.kind == BlockKind::Loop {
            return match block.first_use {
                Some(span) => Err(file.wrong(&span, CompensationFinding::FramesInLoop)),
                None => Ok(()),
            };
        }
        let line = file.line(line.span.start);
        let chosen = unknown(|frame| CompensationFinding::FrameChosen { frame, line });
        for ((active, before), chosen) in self.active.iter_mut().zip(block.before).zip(chosen) {
            if *active != before || block.changed {
                *active = chosen;
            }
        }
        Ok(())
    }
}

/// The values of the names in a program.
pub(super) struct Definitions<'a> {
    pub(super) file: Text<'a>,
    pub(super) constants: Constants<'a>,
    /// The names to which the `.src` assigns a computed value or a second one, with that assignment.
    pub(super) variables: HashMap<String, Span>,
}

impl Definitions<'_> {
    /// Applies a line that sets a frame; `false` if it is another statement.
    pub(super) fn set(&self, frames: &mut ActiveFrames, line: &Line<'_>) -> Result<bool, Diagnostic> {
        match line.word.as_str() {
            "$TOOL" => frames[FrameKind::Tool as usize] = self.assigned(FrameKind::Tool, line)?,
            "$BASE" => frames[FrameKind::Base as usize] = self.assigned(FrameKind::Base, line)?,
            "BAS" => return self.bas(frames, line),
            "FDAT_ACT" => {
                let mut parser = line.parser(self.file)?;
                parser.tokens.advance();
                parser.tokens.expect("=")?;
                let (name, span) = parser.name()?;
                *frames = self.frame_data(&name, &span)?;
            }
            _ => return Ok(false),
        }
        Ok(true)
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
    fn bas(&self, frames: &mut ActiveFrames, line: &Line<'_>) -> Result<bool, Diagnostic> {
        let mut parser = line.parser(self.file)?;
        parser.tokens.advance();
        parser.tokens.expect("(")?;
        let Token::Enum(command) = parser.tokens.peek() else { return Ok(false) };
        let kind = match command.as_str() {
            "TOOL" => FrameKind::Tool,
            "BASE" => FrameKind::Base,
            _ => return Ok(false),
        };
        parser.tokens.advance();
        parser.tokens.expect(",")?;
        let index = parser.expression()?;
        frames[kind as usize] = match index.index() {
            Some(number) => self.numbered(kind, number, &index.span)?,
            None => self.computed(kind, &index.span),
        };
        Ok(true)
    }

    /// `WITH $TOOL=..` after a spline motion: frames for this motion only.
    pub(super) fn with(&self, frames: &mut ActiveFrames, parser: &mut Parser<'_>) -> Result<(), Diagnostic> {
        while !parser.tokens.is_line_end() {
            let kind = [FrameKind::Tool, FrameKind::Base]
                .into_iter()
                .find(|kind| parser.tokens.is_name(kind.name()));
            parser.tokens.advance();
            if let Some(kind) = kind
                && parser.tokens.accept("=")
            {
                frames[kind as usize] = self.value(kind, parser)?;
            }
        }
        Ok(())
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
        let (frame_data, span) = parser.name()?;
        if !matches!(function, "STOOL" | "STOOL2" | "SBASE") {
            return Ok(self.computed(kind, &start));
        }
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

    /// The frame of a constant; an error is reported at `span`, where it is used.
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
        let name = format!("{}[{index}]", kind.array());
        match self.constants.get((kind.array(), Some(index))) {
            Some(constant) if constant.origin != Origin::Source => {
                self.known(constant.value, &name, span).map(Ok)
            }
            _ => Ok(Err(CompensationFinding::FrameElsewhere { frame: kind.name(), name })),
        }
    }

    /// The frames of an FDAT, which belongs to the point of an inline form.
    fn frame_data(&self, name: &str, span: &Span) -> Result<ActiveFrames, Diagnostic> {
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
