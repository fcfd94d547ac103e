//! The ways through a program, and the settings in force on them.
//!
//! A program is corrected, not executed. The settings on which its motions depend (frames, modes, variables) are
//! followed along all ways through its choices, loops, jumps and calls. A setting that differs where two ways join is
//! not known from there on.

use std::collections::{BTreeSet, HashMap};

use dbbd_model::diagnostic::Diagnostic;

/// The effect of a statement on which statement runs after it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Control {
    /// IF: its first way follows.
    If,
    /// SWITCH, TEST: its ways follow, each after a [`Control::Way`].
    Cases,
    /// ELSEIF, CASE.
    Way,
    /// ELSE, DEFAULT: the way that is taken if no other one is.
    LastWay,
    EndChoice,
    /// FOR, WHILE: its statements may be passed over.
    While,
    /// LOOP, REPEAT: its statements run at least once.
    Loop,
    /// ENDFOR, ENDWHILE, ENDLOOP.
    EndLoop,
    /// UNTIL: the end of a loop that is left here.
    Until,
    /// EXIT of KRL, `break`: leaves the innermost loop.
    Break,
    Continue,
    Goto(String),
    Label(String),
    /// RETURN, and other statements that end the program.
    Return,
    /// ERROR of RAPID: the statements after it run after an error in any statement of the routine.
    Handler,
    /// RETRY, TRYNEXT of RAPID: back to the statement with the error, or to the next one.
    Resume,
}

/// The settings in force at a statement.
pub(crate) trait State: Clone + PartialEq {
    /// Joins the state of another way: settings that differ become unknown. Each join leaves the state as it is or
    /// makes less of it known.
    fn join(&mut self, other: &Self);
}

/// A setting with the line (from 1) that set it; line 0 is before the program.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum InForce<T> {
    One {
        value: T,
        line: usize,
    },
    /// Several values are possible: the lines that set two of them.
    Mixed([usize; 2]),
}

impl<T: Clone + PartialEq> InForce<T> {
    pub(crate) fn join(&mut self, other: &Self) {
        match (&*self, other) {
            (Self::One { value, line }, Self::One { value: other, line: other_line }) => {
                if value != other {
                    *self = Self::Mixed([*line.min(other_line), *line.max(other_line)]);
                }
            }
            (Self::One { .. }, Self::Mixed(lines)) => *self = Self::Mixed(*lines),
            (Self::Mixed(_), _) => {}
        }
    }

    /// Makes the setting unknown after a statement in this line that may have set it.
    pub(crate) fn forget(&mut self, line: usize) {
        if let Self::One { line: known, .. } = self {
            *self = Self::Mixed([*known, line]);
        }
    }
}

/// Statements that always run one after the other, and the blocks of which one runs next.
#[derive(Debug, Default)]
struct Block {
    statements: Vec<usize>,
    next: Vec<usize>,
}

/// A block of the language that is open.
enum Open {
    /// The block where the next way begins, the blocks in which the ways so far end, and whether one way is always
    /// taken.
    Choice {
        from: usize,
        ends: Vec<usize>,
        is_complete: bool,
    },
    Loop {
        head: usize,
        after: usize,
    },
}

/// The ways through a routine.
#[derive(Debug)]
pub(crate) struct Ways {
    blocks: Vec<Block>,
}

/// The block at which a routine begins, and the one after its last statement.
const ENTRY: usize = 0;
const EXIT: usize = 1;

impl Ways {
    /// Builds the ways from the statements of a routine: each with its effect on the order, if it has one.
    pub(crate) fn new<'a>(statements: impl IntoIterator<Item = Option<&'a Control>>) -> Self {
        let statements: Vec<Option<&Control>> = statements.into_iter().collect();
        // After an error the handler may follow any statement.
        let is_split = statements.contains(&Some(&Control::Handler));
        let mut builder = Builder {
            blocks: vec![Block::default(), Block::default()],
            current: ENTRY,
            open: Vec::new(),
            labels: HashMap::new(),
            jumps: Vec::new(),
            handlers: Vec::new(),
            resumes: Vec::new(),
        };
        for (at, control) in statements.into_iter().enumerate() {
            if is_split {
                builder.current = builder.block([builder.current]);
            }
            builder.statement(at, control);
        }
        builder.finish()
    }
}

struct Builder {
    blocks: Vec<Block>,
    current: usize,
    open: Vec<Open>,
    labels: HashMap<String, usize>,
    /// The blocks that end in a jump to a label.
    jumps: Vec<(usize, String)>,
    handlers: Vec<usize>,
    resumes: Vec<usize>,
}

impl Builder {
    /// A new block after others. A block after no other block is reached only by jumps.
    fn block(&mut self, after: impl IntoIterator<Item = usize>) -> usize {
        let new = self.blocks.len();
        self.blocks.push(Block::default());
        after.into_iter().for_each(|block| self.link(block, new));
        new
    }

    fn link(&mut self, from: usize, to: usize) {
        self.blocks[from].next.push(to);
    }

    /// The innermost open loop: its head and the block after it.
    fn innermost_loop(&self) -> Option<(usize, usize)> {
        self.open.iter().rev().find_map(|open| match open {
            Open::Loop { head, after } => Some((*head, *after)),
            Open::Choice { .. } => None,
        })
    }

    fn statement(&mut self, at: usize, control: Option<&Control>) {
        match control {
            None => self.blocks[self.current].statements.push(at),
            Some(Control::If) => {
                self.blocks[self.current].statements.push(at);
                let from = self.current;
                self.open.push(Open::Choice { from, ends: Vec::new(), is_complete: false });
                self.current = self.block([from]);
            }
            Some(Control::Cases) => {
                self.blocks[self.current].statements.push(at);
                let from = self.current;
                self.open.push(Open::Choice { from, ends: Vec::new(), is_complete: false });
                self.current = self.block([]);
            }
            Some(control @ (Control::Way | Control::LastWay)) => self.way(at, *control == Control::LastWay),
            Some(Control::EndChoice) => {
                if let Some(Open::Choice { from, mut ends, is_complete }) = self.open.pop() {
                    ends.push(self.current);
                    ends.extend((!is_complete).then_some(from));
                    self.current = self.block(ends);
                }
                self.blocks[self.current].statements.push(at);
            }
            Some(control @ (Control::While | Control::Loop)) => {
                let head = self.block([self.current]);
                self.blocks[head].statements.push(at);
                let after = self.block([]);
                if *control == Control::While {
                    self.link(head, after);
                }
                self.open.push(Open::Loop { head, after });
                self.current = self.block([head]);
            }
            Some(control @ (Control::EndLoop | Control::Until)) => {
                self.blocks[self.current].statements.push(at);
                if let Some(Open::Loop { head, after }) = self.open.pop() {
                    self.link(self.current, head);
                    if *control == Control::Until {
                        self.link(self.current, after);
                    }
                    self.current = after;
                }
            }
            Some(Control::Break) => self.jump(at, self.innermost_loop().map(|(_, after)| after)),
            Some(Control::Continue) => self.jump(at, self.innermost_loop().map(|(head, _)| head)),
            Some(Control::Return) => self.jump(at, Some(EXIT)),
            Some(Control::Goto(label)) => {
                self.jumps.push((self.current, label.clone()));
                self.jump(at, None);
            }
            Some(Control::Label(label)) => {
                self.current = self.block([self.current]);
                self.blocks[self.current].statements.push(at);
                self.labels.insert(label.clone(), self.current);
            }
            Some(Control::Handler) => {
                self.link(self.current, EXIT);
                self.current = self.block([]);
                self.blocks[self.current].statements.push(at);
                self.handlers.push(self.current);
            }
            Some(Control::Resume) => {
                self.resumes.push(self.current);
                self.jump(at, None);
            }
        }
    }

    fn way(&mut self, at: usize, is_last: bool) {
        let Some(Open::Choice { from, ends, is_complete }) = self.open.last_mut() else { return };
        ends.push(self.current);
        *is_complete |= is_last;
        let condition = *from;
        let condition = self.block([condition]);
        self.blocks[condition].statements.push(at);
        if let Some(Open::Choice { from, .. }) = self.open.last_mut() {
            *from = condition;
        }
        self.current = self.block([condition]);
    }

    /// Ends the block with a statement after which `to` runs.
    fn jump(&mut self, at: usize, to: Option<usize>) {
        self.blocks[self.current].statements.push(at);
        to.into_iter().for_each(|to| self.link(self.current, to));
        self.current = self.block([]);
    }

    fn finish(mut self) -> Ways {
        self.link(self.current, EXIT);
        for (from, label) in std::mem::take(&mut self.jumps) {
            if let Some(to) = self.labels.get(&label).copied() {
                self.link(from, to);
            }
        }
        let all = 0..self.blocks.len();
        let (handlers, resumes) = (std::mem::take(&mut self.handlers), std::mem::take(&mut self.resumes));
        if !handlers.is_empty() {
            let error = self.block(all.clone());
            handlers.into_iter().for_each(|handler| self.link(error, handler));
        }
        if !resumes.is_empty() {
            let resumed = self.block(resumes);
            all.for_each(|block| self.link(resumed, block));
        }
        Ways { blocks: self.blocks }
    }
}

/// A statement: the index of its routine, and its index there.
pub(crate) type At = (usize, usize);

/// The routines that each statement calls, in order; indexed by routine and statement.
pub(crate) type Calls = Vec<Vec<Vec<usize>>>;

/// These routines and all routines that they call, directly or through others.
pub(crate) fn reached_from(mut routines: Vec<usize>, calls: &Calls) -> Vec<usize> {
    let mut at = 0;
    while let Some(routine) = routines.get(at).copied() {
        for called in calls[routine].iter().flatten() {
            if !routines.contains(called) {
                routines.push(*called);
            }
        }
        at += 1;
    }
    routines
}

/// A program whose state is followed.
pub(crate) trait Followed {
    type State: State;

    /// The routines of the program that a statement calls, in order.
    fn calls(&self, at: At) -> &[usize];

    /// The state at the begin of a routine that a statement calls.
    fn enter(&self, _at: At, _routine: usize, state: &Self::State) -> Self::State {
        state.clone()
    }

    /// The state after a call, from the state before it and the state at the end of the routine.
    fn leave(&self, _routine: usize, _before: &Self::State, after: Self::State) -> Self::State {
        after
    }

    /// Applies the effect of the statement itself, after its calls.
    fn apply(&self, at: At, state: &mut Self::State);

    /// Makes the state unknown after a statement that may have changed everything.
    fn forget(&self, at: At, state: &mut Self::State);
}

/// Most calls inside each other, and most statements followed. A call beyond these limits is assumed to change
/// everything.
const DEPTH: usize = 50;
const STEPS: usize = 2_000_000;

/// The states with which a routine begins, each with the state at its end; `None` if the routine does not end.
type Ends<S> = Vec<(S, Option<S>)>;

/// The function that is called for each statement with a state in which it runs.
pub(crate) type Visit<'v, S> = &'v mut dyn FnMut(At, &S) -> Result<(), Diagnostic>;

/// Follows the state of a program through its statements.
pub(crate) struct Follower<'p, P: Followed> {
    program: &'p P,
    ways: &'p [Ways],
    /// The states at begin and end, by routine.
    ends: Vec<Ends<P::State>>,
    /// The states with which each routine was visited, by routine.
    visited: Vec<Vec<P::State>>,
    calling: Vec<usize>,
    steps: usize,
}

impl<'p, P: Followed> Follower<'p, P> {
    /// A follower of a program; `ways` are the ways through each of its routines.
    pub(crate) fn new(program: &'p P, ways: &'p [Ways]) -> Self {
        let empty = || ways.iter().map(|_| Vec::new()).collect();
        let visited = ways.iter().map(|_| Vec::new()).collect();
        Self { program, ways, ends: empty(), visited, calling: Vec::new(), steps: 0 }
    }

    /// Whether a routine was visited.
    pub(crate) fn has_visited(&self, routine: usize) -> bool {
        self.visited.get(routine).is_some_and(|states| !states.is_empty())
    }

    /// Visits each statement that a routine reaches, about in the order in which they run. Each is visited with all its
    /// possible states: the states after its calls and before its own effect.
    pub(crate) fn visit(
        &mut self,
        routine: usize,
        entry: P::State,
        visit: Visit<'_, P::State>,
    ) -> Result<(), Diagnostic> {
        if self.visited[routine].contains(&entry) {
            return Ok(());
        }
        self.visited[routine].push(entry.clone());
        self.calling.push(routine);
        let states = self.states(routine, entry);
        for (block, state) in self.ways[routine].blocks.iter().zip(states) {
            let Some(mut state) = state else { continue };
            for statement in &block.statements {
                let at = (routine, *statement);
                for called in self.program.calls(at) {
                    let entry = self.entry(at, *called, &state);
                    self.visit(*called, entry, visit)?;
                }
                if !self.call(at, &mut state) {
                    break;
                }
                visit(at, &state)?;
                self.program.apply(at, &mut state);
            }
        }
        self.calling.pop();
        Ok(())
    }

    /// Whether a call is not followed: it is a recursion, or beyond the limits.
    fn is_beyond(&self, routine: usize) -> bool {
        self.calling.contains(&routine) || self.calling.len() > DEPTH || self.steps > STEPS
    }

    fn entry(&self, at: At, called: usize, state: &P::State) -> P::State {
        let mut entry = self.program.enter(at, called, state);
        if self.is_beyond(called) {
            self.program.forget(at, &mut entry);
        }
        entry
    }

    /// Runs the calls of a statement; `false` if a routine does not return.
    fn call(&mut self, at: At, state: &mut P::State) -> bool {
        self.steps += 1;
        for called in self.program.calls(at) {
            if self.is_beyond(*called) {
                self.program.forget(at, state);
                continue;
            }
            let entry = self.program.enter(at, *called, state);
            let Some(end) = self.end(*called, entry) else { return false };
            *state = self.program.leave(*called, state, end);
        }
        true
    }

    /// The state at the end of a routine.
    fn end(&mut self, routine: usize, entry: P::State) -> Option<P::State> {
        if let Some((_, end)) = self.ends[routine].iter().find(|(known, _)| *known == entry) {
            return end.clone();
        }
        self.calling.push(routine);
        let end = self.states(routine, entry.clone()).swap_remove(EXIT);
        self.calling.pop();
        self.ends[routine].push((entry, end.clone()));
        end
    }

    /// The state at the begin of each block of a routine; `None` for a block that is not reached.
    fn states(&mut self, routine: usize, entry: P::State) -> Vec<Option<P::State>> {
        let ways = &self.ways[routine];
        let mut states = vec![None; ways.blocks.len()];
        states[ENTRY] = Some(entry);
        let mut changed = BTreeSet::from([ENTRY]);
        while let Some(at) = changed.pop_first() {
            let (block, Some(mut state)) = (&ways.blocks[at], states[at].clone()) else { continue };
            let mut run = |at| {
                let returns = self.call(at, &mut state);
                self.program.apply(at, &mut state);
                returns
            };
            if !block.statements.iter().all(|statement| run((routine, *statement))) {
                continue;
            }
            for next in &block.next {
                let known = &mut states[*next];
                let mut joined = known.clone().unwrap_or_else(|| state.clone());
                joined.join(&state);
                if known.as_ref() != Some(&joined) {
                    *known = Some(joined);
                    changed.insert(*next);
                }
            }
        }
        states
    }
}
