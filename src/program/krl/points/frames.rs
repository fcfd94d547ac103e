//! What `$TOOL` and `$BASE` are at each motion.
//!
//! They are followed down the text. Where branches of a choice leave them different they are unknown after it; where a
//! loop changes them, a motion before the change would run under both.

use std::collections::HashMap;

use super::line::Line;
use crate::catalogue::CompensationFinding;
use crate::diagnostic::Diagnostic;
use crate::program::Target;
use crate::program::krl::data::{Constants, Origin, key};
use crate::program::krl::evaluate::constant_target;
use crate::program::krl::lexer::Token;
use crate::program::krl::parser::Parser;
use crate::program::krl::syntax::{Expression, ExpressionKind, Field, Place, Span, Text};
use crate::program::krl::value::Value;
use crate::robot::Pose;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Slot {
    Tool,
    Base,
}

impl Slot {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Tool => "$TOOL",
            Self::Base => "$BASE",
        }
    }

    pub(super) fn option(self) -> &'static str {
        match self {
            Self::Tool => "--tool",
            Self::Base => "--base",
        }
    }

    /// Where `$config.dat` numbers them.
    fn array(self) -> &'static str {
        match self {
            Self::Tool => "TOOL_DATA",
            Self::Base => "BASE_DATA",
        }
    }
}

/// A frame, or why it is not known; the same reason is the same frame.
pub(super) type Frame = Result<Pose, CompensationFinding>;

/// `$TOOL` and `$BASE`, by [`Slot`].
pub(super) type Following = [Frame; 2];

/// Neither known, for a reason.
pub(super) fn unknown(why: impl Fn(&'static str) -> CompensationFinding) -> Following {
    [Slot::Tool, Slot::Base].map(|slot| Err(why(slot.name())))
}

/// What an open block does when its end is reached.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Ends {
    Once,
    Repeated,
}

/// A choice or loop that is open.
struct Open {
    /// The frames before it.
    before: Following,
    ends: Ends,
    /// Whether some branch left the frames different.
    differs: bool,
    /// The first motion that ran under the frames from before.
    used: Option<Span>,
}

pub(super) struct Follower {
    pub(super) now: Following,
    open: Vec<Open>,
}

impl Follower {
    pub(super) fn new() -> Self {
        Self { now: unknown(|frame| CompensationFinding::FrameNotSet { frame }), open: Vec::new() }
    }

    /// Notes that a motion runs under the frames as they are.
    pub(super) fn used(&mut self, span: &Span) {
        for open in self.open.iter_mut().filter(|open| open.before == self.now) {
            open.used.get_or_insert_with(|| span.clone());
        }
    }

    /// Follows a line of control flow; whether it was one.
    pub(super) fn control(&mut self, file: Text<'_>, line: &Line<'_>) -> Result<bool, Diagnostic> {
        match line.word.as_str() {
            "IF" | "SWITCH" => self.open(Ends::Once),
            "FOR" | "WHILE" | "LOOP" | "REPEAT" => self.open(Ends::Repeated),
            "ELSE" | "CASE" | "DEFAULT" => {
                if let Some(open) = self.open.last_mut() {
                    open.differs |= self.now != open.before;
                    self.now = open.before.clone();
                }
            }
            "ENDIF" | "ENDSWITCH" | "ENDFOR" | "ENDWHILE" | "ENDLOOP" | "UNTIL" => self.close(file, line)?,
            _ => return Ok(false),
        }
        Ok(true)
    }

    fn open(&mut self, ends: Ends) {
        self.open.push(Open { before: self.now.clone(), ends, differs: false, used: None });
    }

    fn close(&mut self, file: Text<'_>, line: &Line<'_>) -> Result<(), Diagnostic> {
        let Some(open) = self.open.pop() else { return Ok(()) };
        if !open.differs && self.now == open.before {
            return Ok(());
        }
        if open.ends == Ends::Repeated {
            return match open.used {
                Some(span) => Err(file.wrong(&span, CompensationFinding::FramesInLoop)),
                None => Ok(()),
            };
        }
        let line = file.line(line.span.start);
        let chosen = unknown(|frame| CompensationFinding::FrameChosen { frame, line });
        for ((now, before), chosen) in self.now.iter_mut().zip(open.before).zip(chosen) {
            if *now != before || open.differs {
                *now = chosen;
            }
        }
        Ok(())
    }
}

/// What the names on the right of a frame mean.
pub(super) struct Values<'a> {
    pub(super) file: Text<'a>,
    pub(super) constants: Constants<'a>,
    /// What the `.src` sets more than once, or to a value that is computed, and where.
    pub(super) varying: HashMap<String, Span>,
}

impl Values<'_> {
    /// Takes what a line sets of the frames; whether it did.
    pub(super) fn set(&self, frames: &mut Following, line: &Line<'_>) -> Result<bool, Diagnostic> {
        match line.word.as_str() {
            "$TOOL" => frames[Slot::Tool as usize] = self.assigned(Slot::Tool, line)?,
            "$BASE" => frames[Slot::Base as usize] = self.assigned(Slot::Base, line)?,
            "BAS" => return self.bas(frames, line),
            "FDAT_ACT" => {
                let mut parser = line.parser(self.file)?;
                parser.advance();
                parser.sign("=")?;
                let (name, span) = parser.name()?;
                *frames = self.companion(&name, &span)?;
            }
            _ => return Ok(false),
        }
        Ok(true)
    }

    fn assigned(&self, slot: Slot, line: &Line<'_>) -> Result<Frame, Diagnostic> {
        let mut parser = line.parser(self.file)?;
        parser.advance();
        if !parser.accept_sign("=") {
            let line = self.file.line(line.span.start);
            return Ok(Err(CompensationFinding::FramePart { frame: slot.name(), line }));
        }
        self.value(slot, &mut parser)
    }

    /// `BAS (#TOOL,1)`
    fn bas(&self, frames: &mut Following, line: &Line<'_>) -> Result<bool, Diagnostic> {
        let mut parser = line.parser(self.file)?;
        parser.advance();
        parser.sign("(")?;
        let slot = match parser.peek() {
            Token::Enum(command) if command == "TOOL" => Slot::Tool,
            Token::Enum(command) if command == "BASE" => Slot::Base,
            _ => return Ok(false),
        };
        parser.advance();
        parser.sign(",")?;
        let index = parser.expression()?;
        frames[slot as usize] = match index.index() {
            Some(number) => self.numbered(slot, number, &index.span)?,
            None => self.computed(slot, &index.span),
        };
        Ok(true)
    }

    /// What follows `WITH` in a spline motion: frames for this motion only.
    pub(super) fn with(&self, frames: &mut Following, parser: &mut Parser<'_>) -> Result<(), Diagnostic> {
        while !matches!(parser.peek(), Token::LineEnd | Token::End) {
            let slot = [Slot::Tool, Slot::Base].into_iter().find(|slot| parser.is_name(slot.name()));
            parser.advance();
            if let Some(slot) = slot
                && parser.accept_sign("=")
            {
                frames[slot as usize] = self.value(slot, parser)?;
            }
        }
        Ok(())
    }

    fn computed(&self, slot: Slot, span: &Span) -> Frame {
        let line = self.file.line(span.start);
        Err(CompensationFinding::FrameComputed { frame: slot.name(), line })
    }

    /// A frame on the right of `$TOOL=` or `$BASE=`.
    fn value(&self, slot: Slot, parser: &mut Parser<'_>) -> Result<Frame, Diagnostic> {
        if let (Token::Name(name), Token::Sign("(")) = (parser.peek().clone(), parser.ahead(1)) {
            return self.inline_form(slot, &name, parser);
        }
        let expression = parser.expression()?;
        if matches!(parser.peek(), Token::Sign(":")) {
            return Ok(self.computed(slot, &expression.span));
        }
        match &expression.kind {
            ExpressionKind::Aggregate(_) => self.known(&expression, slot.name(), &expression.span).map(Ok),
            ExpressionKind::Place(place) if place.name == "$NULLFRAME" => Ok(Ok(Pose::identity())),
            ExpressionKind::Place(place) => self.named(slot, place),
            _ => Ok(self.computed(slot, &expression.span)),
        }
    }

    /// Functions of KUKA's inline forms: `STOOL2(FP1)`, `SBASE(FP1.BASE_NO)`.
    fn inline_form(&self, slot: Slot, function: &str, parser: &mut Parser<'_>) -> Result<Frame, Diagnostic> {
        let start = parser.span();
        parser.advance();
        parser.advance();
        let (of, span) = parser.name()?;
        if !matches!(function, "STOOL" | "STOOL2" | "SBASE") {
            return Ok(self.computed(slot, &start));
        }
        let companion = self.companion(&of, &span)?;
        while !parser.accept_sign(")") {
            if matches!(parser.peek(), Token::LineEnd | Token::End) {
                return Err(parser.unexpected("`)`"));
            }
            parser.advance();
        }
        let [tool, base] = companion;
        Ok(if function == "SBASE" { base } else { tool })
    }

    fn named(&self, slot: Slot, place: &Place) -> Result<Frame, Diagnostic> {
        let Some(key) = key(place) else { return Ok(self.computed(slot, &place.span)) };
        if let (array @ ("TOOL_DATA" | "BASE_DATA"), Some(index)) = key {
            let of = if array == "TOOL_DATA" { Slot::Tool } else { Slot::Base };
            return self.numbered(of, index, &place.span);
        }
        if let Some(set) = self.varying.get(key.0) {
            return Ok(self.computed(slot, set));
        }
        match self.constants.get(key) {
            Some(constant) => self.known(constant.value, key.0, &place.span).map(Ok),
            None => {
                let name = place.name.clone();
                Ok(Err(CompensationFinding::FrameElsewhere { frame: slot.name(), name }))
            }
        }
    }

    /// The frame that a constant gives; what is wrong with it is reported at `span`, where it is used.
    fn known(&self, value: &Expression, name: &str, span: &Span) -> Result<Pose, Diagnostic> {
        match constant_target(value) {
            Ok(Target::Pose { xyz_mm, abc_deg, .. }) => Ok(Pose::from_kuka(xyz_mm, abc_deg)),
            Ok(Target::Axes(_)) => {
                let why = "these are axis angles".into();
                Err(self.file.wrong(span, CompensationFinding::PointIncomplete { name: name.into(), why }))
            }
            Err(fault) => {
                let why = fault.finding.to_string();
                Err(self.file.wrong(span, CompensationFinding::PointIncomplete { name: name.into(), why }))
            }
        }
    }

    /// `TOOL_DATA[n]`, `BASE_DATA[n]`; number 0 is the null frame.
    fn numbered(&self, slot: Slot, index: i64, span: &Span) -> Result<Frame, Diagnostic> {
        if index == 0 {
            return Ok(Ok(Pose::identity()));
        }
        let name = format!("{}[{index}]", slot.array());
        match self.constants.get((slot.array(), Some(index))) {
            Some(constant) if constant.origin != Origin::Source => {
                self.known(constant.value, &name, span).map(Ok)
            }
            _ => Ok(Err(CompensationFinding::FrameElsewhere { frame: slot.name(), name })),
        }
    }

    /// The frames of an inline form's FDAT.
    fn companion(&self, name: &str, span: &Span) -> Result<Following, Diagnostic> {
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
            let index = component(name).and_then(|Field { value, .. }| match value.constant() {
                Ok(Value::Int(index)) => Some(index),
                _ => None,
            });
            index.ok_or_else(|| wrong(format!("{name} is missing")))
        };
        let tool = self.numbered(Slot::Tool, number("TOOL_NO")?, span)?;
        Ok([tool, self.numbered(Slot::Base, number("BASE_NO")?, span)?])
    }
}
