//! Goes through a program's lines for its motions.

use std::collections::HashMap;

use super::constants::{self, Constants, Key, number, whole};
use super::frames::{self, Follower, Frame, Frames};
use super::line::{Line, lines};
use super::{Files, Given, Origin, PointProgram, Position, TaughtPoint, Text};
use crate::diag::Diagnostic;
use crate::krl::lexer::Token;
use crate::krl::syntax::{Expression, ExpressionKind, Field, Part, Span};
use crate::model::Pose;

/// A tool or base that is given differs by this much (mm, or of a rotation matrix) from the program's.
const SAME: f64 = 1e-6;

pub(super) struct Walk<'a> {
    files: Files<'a>,
    given: Given,
    constants: Constants,
    points: Vec<TaughtPoint>,
    /// Where each named point stands in `points`.
    found: HashMap<Key, usize>,
    left: Vec<Diagnostic>,
    /// What `--tool` and `--base` stand for, by the reason why the program does not tell.
    stands_for: [Option<String>; 2],
}

impl<'a> Walk<'a> {
    pub(super) fn new(files: Files<'a>, given: Given) -> Result<Self, Diagnostic> {
        let mut constants = Constants::default();
        if let Some(config) = files.config {
            constants.add_data(config, Origin::Config)?;
        }
        if let Some(data) = files.data {
            constants.add_data(data, Origin::Data)?;
        }
        for line in lines(files.source) {
            constants.add_assignment(files.source, &line);
        }
        Ok(Self {
            files,
            given,
            constants,
            points: Vec::new(),
            found: HashMap::new(),
            left: Vec::new(),
            stands_for: [None, None],
        })
    }

    pub(super) fn read(mut self) -> Result<PointProgram, Diagnostic> {
        let file = self.files.source;
        let setters = self.routines_that_set_frames();
        let mut follower = Follower::new();
        let mut spline: Option<Frames> = None;
        for line in lines(file) {
            if follower.control(file, &line)? {
                continue;
            }
            match line.word.as_str() {
                "DEF" | "DEFFCT" => follower = Follower::new(),
                "GLOBAL" if starts_routine(&line) => follower = Follower::new(),
                "PTP" | "SPTP" | "LIN" | "SLIN" | "CIRC" | "SCIRC" | "SPL" => {
                    let under = spline.as_ref().unwrap_or(&follower.now).clone();
                    if self.motion(&line, under)? == follower.now {
                        follower.used(&line.span);
                    }
                }
                "SPLINE" | "PTP_SPLINE" => {
                    let mut under = follower.now.clone();
                    frames::with(&mut under, &self.constants, file, &line, &mut line.parser(file)?)?;
                    spline = Some(under);
                }
                "ENDSPLINE" => spline = None,
                word if word.ends_with("_REL") && is_relative(word) => {
                    let message = "a relative motion stays as it is: it starts from a corrected point";
                    self.left.push(file.wrong(&line.span, message));
                }
                word => {
                    let set = frames::set(&mut follower.now, &self.constants, file, &line)?;
                    if !set && setters.iter().any(|name| name == word) {
                        let why = format!("{word} sets it");
                        follower.now =
                            Frames { tool: Frame::Unknown(why.clone()), base: Frame::Unknown(why) };
                    }
                }
            }
        }
        Ok(PointProgram { points: self.points, left: self.left })
    }

    /// The file's routines that set a frame: after a call of one nothing is known.
    fn routines_that_set_frames(&self) -> Vec<String> {
        let mut names: Vec<String> = Vec::new();
        let mut routine = String::new();
        for line in lines(self.files.source) {
            let sets = match line.word.as_str() {
                "DEF" | "DEFFCT" | "GLOBAL" if line.word != "GLOBAL" || starts_routine(&line) => {
                    let head = line.code().split('(').next().unwrap_or("");
                    routine = head.split_ascii_whitespace().last().unwrap_or("").to_ascii_uppercase();
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

    /// Takes the points of a motion; the frames under which it runs.
    fn motion(&mut self, line: &Line<'_>, mut under: Frames) -> Result<Frames, Diagnostic> {
        let file = self.files.source;
        let mut parser = line.parser(file)?;
        parser.advance();
        let mut targets = vec![parser.expression()?];
        if matches!(line.word.as_str(), "CIRC" | "SCIRC") {
            parser.sign(",")?;
            targets.push(parser.expression()?);
        }
        if matches!(parser.peek(), Token::Sign(":")) {
            return Err(file
                .wrong(&line.span, "a motion to a point that is computed cannot be compensated")
                .help("write the point itself, and its frame as $BASE"));
        }
        frames::with(&mut under, &self.constants, file, line, &mut parser)?;
        let by_ptp = matches!(line.word.as_str(), "PTP" | "SPTP");
        for target in &targets {
            self.target(line, target, &under, by_ptp)?;
        }
        Ok(under)
    }

    /// Takes the point or points that a motion goes to.
    fn target(
        &mut self,
        line: &Line<'_>,
        target: &Expression,
        under: &Frames,
        by_ptp: bool,
    ) -> Result<(), Diagnostic> {
        let file = self.files.source;
        let place = match &target.kind {
            ExpressionKind::Aggregate(_) => {
                let point = self.point("inline", target, Origin::Source, line, under, by_ptp)?;
                self.points.push(point);
                return Ok(());
            }
            ExpressionKind::Place(place) => place,
            _ => return Err(file.wrong(&target.span, "this is no point")),
        };
        if let Some(set) = self.constants.varies(&place.name) {
            let message = format!("{} is computed in line {}", place.name, file.line(set.start));
            return Err(file
                .wrong(&place.span, message)
                .help("only points with one fixed value can be compensated"));
        }
        let keys: Vec<Key> = match (constants::key(place), place.parts.as_slice()) {
            (Some(key), _) => vec![key],
            // An index that is computed: any element may be meant.
            (None, [Part::Element(_)]) => {
                let elements = self.constants.elements(&place.name);
                elements.iter().map(|index| (place.name.clone(), Some(*index))).collect()
            }
            _ => Vec::new(),
        };
        let mut taken = false;
        for key in keys {
            let Some(constant) = self.constants.get(&key).cloned() else { continue };
            if constant.origin == Origin::Config || place.name.starts_with("XHOME") {
                continue;
            }
            taken = true;
            let name = match key.1 {
                Some(index) => format!("{}[{index}]", key.0),
                None => key.0.clone(),
            };
            let point = self.point(&name, &constant.value, constant.origin, line, under, by_ptp)?;
            match self.found.get(&key).and_then(|at| self.points.get_mut(*at)) {
                None => {
                    self.found.insert(key, self.points.len());
                    self.points.push(point);
                }
                Some(before) if same_frames(&before.position, &point.position) => {
                    before.by_ptp |= by_ptp;
                }
                Some(before) => {
                    let first = file.line(before.used.start);
                    let message = format!("{name} is used with another tool or base in line {first}");
                    return Err(file
                        .wrong(&place.span, message)
                        .help("give each use a point of its own: the correction depends on the frames"));
                }
            }
        }
        if !taken && !place.name.starts_with("XHOME") {
            let message = format!("{} stays as it is: it has no value in the program's files", place.name);
            self.left.push(file.wrong(&place.span, message));
        }
        Ok(())
    }

    fn point(
        &mut self,
        name: &str,
        value: &Expression,
        origin: Origin,
        line: &Line<'_>,
        under: &Frames,
        by_ptp: bool,
    ) -> Result<TaughtPoint, Diagnostic> {
        let stands_in = match (origin, self.files.data) {
            (Origin::Data, Some(data)) => data,
            _ => self.files.source,
        };
        let ExpressionKind::Aggregate(fields) = &value.kind else {
            return Err(stands_in.wrong(&value.span, format!("{name} is no point")));
        };
        let wrong = |why: String| {
            stands_in
                .wrong(&value.span, format!("{name}: {why}"))
                .help("a component that is missing is taken from wherever the robot stands: give all six")
        };
        let six = |names: [&str; 6]| -> Result<[super::Number; 6], Diagnostic> {
            let [a, b, c, d, e, f] = names.map(|name| number(fields, name).map_err(wrong));
            Ok([a?, b?, c?, d?, e?, f?])
        };
        let has_axes = |field: &Field| matches!(field.name.as_str(), "A1" | "A2" | "A3" | "A4" | "A5" | "A6");
        let position = if fields.iter().any(has_axes) {
            Position::Axes(six(["A1", "A2", "A3", "A4", "A5", "A6"])?)
        } else {
            Position::Pose {
                numbers: six(["X", "Y", "Z", "A", "B", "C"])?,
                status: whole(fields, "S").map_err(wrong)?.map(|(value, _)| value),
                turn: whole(fields, "T").map_err(wrong)?,
                tool: self.resolve(0, &under.tool, &line.span)?,
                base: self.resolve(1, &under.base, &line.span)?,
            }
        };
        let (span, used) = (value.span.clone(), line.span.clone());
        Ok(TaughtPoint { name: name.into(), origin, span, used, by_ptp, position })
    }

    /// `$TOOL` (0) or `$BASE` (1): what the program tells, else what the user gave.
    fn resolve(&mut self, which: usize, frame: &Frame, span: &Span) -> Result<Pose, Diagnostic> {
        let file: Text<'_> = self.files.source;
        let (name, option, given) = match which {
            0 => ("$TOOL", "--tool", self.given.tool),
            _ => ("$BASE", "--base", self.given.base),
        };
        match (frame, given) {
            (Frame::Known(pose), None) => Ok(*pose),
            (Frame::Known(pose), Some(given)) => {
                let off = (pose.position - given.position).norm() + (pose.rotation - given.rotation).norm();
                if off > SAME {
                    let message = format!("the program sets {name} itself, and not to what {option} says");
                    return Err(file
                        .wrong(span, message)
                        .help(format!("leave {option} away, or correct it")));
                }
                Ok(*pose)
            }
            (Frame::Unknown(why), None) => {
                let help = format!("give --config $config.dat, or {option} X,Y,Z,A,B,C");
                Err(file.wrong(span, format!("{name} is not known here: {why}")).help(help))
            }
            (Frame::Unknown(why), Some(given)) => match self.stands_for.get_mut(which) {
                Some(Some(before)) if before != why => {
                    let message =
                        format!("{option} would stand for two frames: {before}, and elsewhere: {why}");
                    Err(file.wrong(span, message).help("give --config $config.dat"))
                }
                Some(slot) => {
                    *slot = Some(why.clone());
                    Ok(given)
                }
                None => Ok(given),
            },
        }
    }
}

fn starts_routine(line: &Line<'_>) -> bool {
    line.text
        .split_ascii_whitespace()
        .nth(1)
        .is_some_and(|word| word.eq_ignore_ascii_case("DEF") || word.eq_ignore_ascii_case("DEFFCT"))
}

fn is_relative(word: &str) -> bool {
    matches!(word.trim_end_matches("_REL"), "PTP" | "LIN" | "CIRC" | "SPTP" | "SLIN" | "SCIRC" | "SPL")
}

fn same_frames(a: &Position, b: &Position) -> bool {
    match (a, b) {
        (Position::Axes(_), Position::Axes(_)) => true,
        (Position::Pose { tool: t, base: u, .. }, Position::Pose { tool: v, base: w, .. }) => {
            (t, u) == (v, w)
        }
        _ => false,
    }
}
