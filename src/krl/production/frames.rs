//! What `$TOOL` and `$BASE` are at each motion.
//!
//! They are followed down the text. Where branches of a choice leave them different they are unknown
//! after it; where a loop changes them, a motion before the change would run under both.

use super::constants::{self, Constants, number, whole};
use super::line::Line;
use super::{Origin, Text};
use crate::diag::Diagnostic;
use crate::krl::lexer::Token;
use crate::krl::parser::Parser;
use crate::krl::syntax::{Expression, ExpressionKind, Span};
use crate::model::Pose;

/// A frame, or why it is not known.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Frame {
    Known(Pose),
    /// What stands in the way; the same words mean the same frame.
    Unknown(String),
}

/// `$TOOL` and `$BASE`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Frames {
    pub(super) tool: Frame,
    pub(super) base: Frame,
}

impl Frames {
    /// At the start of a routine.
    pub(super) fn start() -> Self {
        let unset = |name: &str| Frame::Unknown(format!("nothing sets {name} before this"));
        Self { tool: unset("$TOOL"), base: unset("$BASE") }
    }
}

/// A choice or loop that is open.
struct Open {
    /// The frames before it.
    before: Frames,
    /// Whether it runs again from its start.
    again: bool,
    /// Whether some branch left the frames different.
    differs: bool,
    /// The first motion that ran under the frames from before.
    used: Option<Span>,
}

/// Follows the frames.
pub(super) struct Follower {
    pub(super) now: Frames,
    open: Vec<Open>,
}

impl Follower {
    pub(super) fn new() -> Self {
        Self { now: Frames::start(), open: Vec::new() }
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
            "IF" | "SWITCH" | "FOR" | "WHILE" | "LOOP" | "REPEAT" => {
                let again = !matches!(line.word.as_str(), "IF" | "SWITCH");
                self.open.push(Open { before: self.now.clone(), again, differs: false, used: None });
            }
            "ELSE" | "CASE" | "DEFAULT" => {
                if let Some(open) = self.open.last_mut() {
                    open.differs |= self.now != open.before;
                    self.now = open.before.clone();
                }
            }
            "ENDIF" | "ENDSWITCH" | "ENDFOR" | "ENDWHILE" | "ENDLOOP" | "UNTIL" => {
                let Some(open) = self.open.pop() else { return Ok(true) };
                let differs = open.differs || self.now != open.before;
                if open.again && differs {
                    if let Some(span) = open.used {
                        let message = "this motion runs under other frames when the loop comes round";
                        return Err(file
                            .wrong(&span, message)
                            .help("set $TOOL and $BASE at the start of the loop"));
                    }
                } else if differs {
                    let message = |name| {
                        let line = file.line(line.span.start);
                        Frame::Unknown(format!("the choice that ends in line {line} may set {name}"))
                    };
                    if self.now.tool != open.before.tool || open.differs {
                        self.now.tool = message("$TOOL");
                    }
                    if self.now.base != open.before.base || open.differs {
                        self.now.base = message("$BASE");
                    }
                }
            }
            _ => return Ok(false),
        }
        Ok(true)
    }
}

/// Takes what a line sets of the frames; whether it did.
pub(super) fn set(
    frames: &mut Frames,
    constants: &Constants,
    file: Text<'_>,
    line: &Line<'_>,
) -> Result<bool, Diagnostic> {
    match line.word.as_str() {
        "$TOOL" | "$BASE" => {
            let mut parser = line.parser(file)?;
            parser.advance();
            let slot = if line.word == "$TOOL" { &mut frames.tool } else { &mut frames.base };
            if !parser.accept_sign("=") {
                *slot = Frame::Unknown(format!("line {} sets a part of it", file.line(line.span.start)));
                return Ok(true);
            }
            *slot = value(&mut parser, constants, file, line)?;
        }
        "BAS" => {
            let mut parser = line.parser(file)?;
            parser.advance();
            parser.sign("(")?;
            let Token::Enum(command) = parser.peek().clone() else { return Ok(false) };
            let (slot, array) = match command.as_str() {
                "TOOL" => (&mut frames.tool, "TOOL_DATA"),
                "BASE" => (&mut frames.base, "BASE_DATA"),
                _ => return Ok(false),
            };
            parser.advance();
            parser.sign(",")?;
            let index = parser.expression()?;
            let ExpressionKind::Int(number) = index.kind else {
                *slot = Frame::Unknown(format!("BAS (#{command},..) takes a number that is computed"));
                return Ok(true);
            };
            *slot = numbered(constants, file, array, number, &index.span)?;
        }
        "FDAT_ACT" => {
            let mut parser = line.parser(file)?;
            parser.advance();
            parser.sign("=")?;
            let (name, span) = parser.name()?;
            *frames = companion(constants, file, &name, &span)?;
        }
        _ => return Ok(false),
    }
    Ok(true)
}

/// What follows `WITH` in a spline motion: frames for this motion only.
pub(super) fn with(
    frames: &mut Frames,
    constants: &Constants,
    file: Text<'_>,
    line: &Line<'_>,
    parser: &mut Parser<'_>,
) -> Result<(), Diagnostic> {
    while !matches!(parser.peek(), Token::LineEnd | Token::End) {
        let slot = match parser.peek() {
            Token::Name(name) if name == "$TOOL" => &mut frames.tool,
            Token::Name(name) if name == "$BASE" => &mut frames.base,
            _ => {
                parser.advance();
                continue;
            }
        };
        parser.advance();
        if parser.accept_sign("=") {
            *slot = value(parser, constants, file, line)?;
        }
    }
    Ok(())
}

/// A frame on the right of `$TOOL=` or `$BASE=`.
fn value(
    parser: &mut Parser<'_>,
    constants: &Constants,
    file: Text<'_>,
    line: &Line<'_>,
) -> Result<Frame, Diagnostic> {
    let computed = || Frame::Unknown(format!("line {} computes it", file.line(line.span.start)));
    if let (Token::Name(name), Token::Sign("(")) = (parser.peek().clone(), parser.ahead(1).clone()) {
        // Functions of KUKA's inline forms: STOOL2(FP1), SBASE(FP1.BASE_NO).
        parser.advance();
        parser.advance();
        let (of, span) = parser.name()?;
        let companion = match name.as_str() {
            "STOOL" | "STOOL2" | "SBASE" => companion(constants, file, &of, &span)?,
            _ => return Ok(computed()),
        };
        while !parser.accept_sign(")") {
            if matches!(parser.peek(), Token::LineEnd | Token::End) {
                return Err(parser.unexpected("`)`"));
            }
            parser.advance();
        }
        return Ok(if name == "SBASE" { companion.base } else { companion.tool });
    }
    let expression = parser.expression()?;
    if matches!(parser.peek(), Token::Sign(":")) {
        return Ok(computed());
    }
    match &expression.kind {
        ExpressionKind::Aggregate(_) => known(&expression, file),
        ExpressionKind::Place(place) if place.name == "$NULLFRAME" => Ok(Frame::Known(Pose::identity())),
        ExpressionKind::Place(place) => {
            let Some((name, index)) = constants::key(place) else { return Ok(computed()) };
            if let (Some(index), "TOOL_DATA" | "BASE_DATA") = (index, name.as_str()) {
                return numbered(constants, file, &name, index, &place.span);
            }
            if let Some(set) = constants.varies(&name) {
                return Ok(Frame::Unknown(format!("{name} is computed in line {}", file.line(set.start))));
            }
            match constants.get(&(name.clone(), index)) {
                Some(constant) => constants::frame(&constant.value)
                    .map(Frame::Known)
                    .map_err(|why| file.wrong(&place.span, format!("{name}: {why}"))),
                None => Ok(Frame::Unknown(format!("{name} is declared in no file given"))),
            }
        }
        _ => Ok(computed()),
    }
}

fn known(expression: &Expression, file: Text<'_>) -> Result<Frame, Diagnostic> {
    constants::frame(expression)
        .map(Frame::Known)
        .map_err(|why| file.wrong(&expression.span, why).help("give all of X, Y, Z, A, B, C"))
}

/// `TOOL_DATA[n]`, `BASE_DATA[n]`; number 0 is the null frame.
fn numbered(
    constants: &Constants,
    file: Text<'_>,
    array: &str,
    index: i64,
    span: &Span,
) -> Result<Frame, Diagnostic> {
    if index == 0 {
        return Ok(Frame::Known(Pose::identity()));
    }
    match constants.get(&(array.to_owned(), Some(index))) {
        Some(constant) if constant.origin != Origin::Source => constants::frame(&constant.value)
            .map(Frame::Known)
            .map_err(|why| file.wrong(span, format!("{array}[{index}]: {why}"))),
        _ => Ok(Frame::Unknown(format!("{array}[{index}] stands in $config.dat"))),
    }
}

/// The frames of an inline form's FDAT.
fn companion(constants: &Constants, file: Text<'_>, name: &str, span: &Span) -> Result<Frames, Diagnostic> {
    let Some(constant) = constants.get(&(name.to_owned(), None)) else {
        let why = format!("{name} stands in no file given");
        return Ok(Frames { tool: Frame::Unknown(why.clone()), base: Frame::Unknown(why) });
    };
    let ExpressionKind::Aggregate(fields) = &constant.value.kind else {
        return Err(file.wrong(span, format!("{name} is no FDAT")));
    };
    let mode = fields.iter().find(|field| field.name == "IPO_FRAME").map(|field| &field.value.kind);
    if matches!(mode, Some(ExpressionKind::Enum(mode)) if mode != "BASE") {
        return Err(file
            .wrong(span, format!("{name} moves the workpiece against a fixed tool (#TCP)"))
            .help("only a tool on the flange (#BASE) can be compensated"));
    }
    let wrong = |why: String| file.wrong(span, format!("{name}: {why}"));
    let index = |component: &str| {
        number(fields, component).map_err(wrong)?;
        whole(fields, component).map_err(wrong).map(|found| found.map_or(0, |(value, _)| value))
    };
    Ok(Frames {
        tool: numbered(constants, file, "TOOL_DATA", index("TOOL_NO")?, span)?,
        base: numbered(constants, file, "BASE_DATA", index("BASE_NO")?, span)?,
    })
}
