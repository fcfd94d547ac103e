//! The motions of a program that stay as they are, in all languages.
//!
//! A motion whose point or frame is computed or not known stays as it is and is named; the others are corrected. A program is
//! refused only where nothing would be right, or where what the user stated contradicts it.

use std::collections::{BTreeMap, HashSet};

use super::text::{Span, Text};
use crate::program::CompensationFinding;
use dbbd_model::diagnostic::Diagnostic;

/// Why motions stay as they are, and their points by a key of the language.
#[derive(Clone, Debug)]
pub(super) struct LeftMotions<Key> {
    reasons: Vec<Diagnostic>,
    /// First bytes of these motions: several ways may lead to one.
    motions: HashSet<usize>,
    /// The points that must stay too, each with the line of such a motion.
    points: BTreeMap<Key, usize>,
}

impl<Key: Ord> LeftMotions<Key> {
    pub(super) fn none() -> Self {
        Self { reasons: Vec::new(), motions: HashSet::new(), points: BTreeMap::new() }
    }

    /// Notes a point of a motion in this line that stays as it is.
    pub(super) fn share(&mut self, point: Key, line: usize) {
        self.points.entry(point).or_insert(line);
    }

    /// The points that must stay, each with the line of a motion that stays.
    pub(super) fn shared(&self) -> impl Iterator<Item = (&Key, usize)> {
        self.points.iter().map(|(point, line)| (point, *line))
    }

    /// The finding about a motion that stays as it is for this reason; `None` if the motion has one.
    ///
    /// # Errors
    /// What the user stated contradicts the program.
    pub(super) fn leave(
        &mut self,
        file: Text<'_>,
        motion: &Span,
        why: Diagnostic,
    ) -> Result<Option<Diagnostic>, Diagnostic> {
        use CompensationFinding::{FrameDiffers, TwoFrames};
        if let Some(FrameDiffers { .. } | TwoFrames { .. }) = why.finding::<CompensationFinding>() {
            return Err(why);
        }
        let is_first = self.motions.insert(motion.start);
        let left =
            is_first.then(|| file.wrong(motion, CompensationFinding::MotionLeft { why: why.message() }));
        self.reasons.push(why);
        Ok(left)
    }

    /// The first reason why nothing of a program would be right: it has no point to correct, or no pose because frames are missing
    /// that a user can give.
    pub(super) fn nothing_right(&self, has_point: bool, has_pose: bool) -> Option<&Diagnostic> {
        use CompensationFinding::{ControllerCorrects, FrameElsewhere, FrameNotSet};
        let is_missing = |why: &&Diagnostic| {
            let finding = why.finding::<CompensationFinding>();
            matches!(finding, Some(FrameNotSet { .. } | FrameElsewhere { .. } | ControllerCorrects { .. }))
        };
        if has_point {
            self.reasons.iter().find(is_missing).filter(|_| !has_pose)
        } else {
            self.reasons.first()
        }
    }
}
