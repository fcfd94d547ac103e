//! The tree of a KRL program. Every node has its bytes in the text, so that a reader can point at them and a writer can
//! replace them and nothing else.

use std::sync::Arc;

use crate::plan::Motion;
pub use crate::program::text::{Span, Text};

/// A `.src` file.
#[derive(Clone, Debug)]
pub struct Source {
    pub file: String,
    pub text: String,
    /// The routines in order; the first is the module's own.
    pub routines: Vec<Routine>,
}

impl Source {
    pub(crate) fn as_text(&self) -> Text<'_> {
        Text { file: &self.file, text: &self.text }
    }
}

/// `DEF .. END`. Names are in capitals, here and below.
#[derive(Clone, Debug)]
pub struct Routine {
    pub name: String,
    /// Of the name.
    pub span: Span,
    /// All are `:IN`.
    pub parameters: Vec<String>,
    /// Before its first statement.
    pub declarations: Vec<Declaration>,
    pub body: Block,
}

/// Statements in order; shared, so that an executor can hold its place in them.
pub type Block = Arc<[Statement]>;

/// A `.dat` file.
#[derive(Clone, Debug)]
pub struct Data {
    pub file: String,
    pub text: String,
    pub name: String,
    pub items: Vec<DataItem>,
}

impl Data {
    pub(crate) fn as_text(&self) -> Text<'_> {
        Text { file: &self.file, text: &self.text }
    }
}

/// A line of a `.dat` file.
#[derive(Clone, Debug)]
pub enum DataItem {
    Declaration(Declaration),
    /// A value for a variable or an element that was declared before.
    Value {
        target: Place,
        value: Expression,
    },
}

#[derive(Clone, Debug)]
pub struct Declaration {
    /// The bytes of the line's content.
    pub span: Span,
    pub kind: DeclarationKind,
}

#[derive(Clone, Debug)]
pub enum DeclarationKind {
    /// `DECL INT A,B[3]=..`
    Variables { type_name: String, names: Vec<Declared> },
    /// `SIGNAL NAME $OUT[9] TO $OUT[16]`
    Signal { name: String, first: Place, last: Option<Place> },
    /// `EXT NAME (..)`: a module elsewhere.
    External { name: String },
}

#[derive(Clone, Debug)]
pub struct Declared {
    pub name: String,
    /// Number of elements, for an array.
    pub elements: Option<usize>,
    pub value: Option<Expression>,
    pub span: Span,
}

#[derive(Clone, Debug)]
pub struct Statement {
    /// Up to the end of its first line.
    pub span: Span,
    pub kind: StatementKind,
}

#[derive(Clone, Debug)]
pub enum StatementKind {
    /// `A=B`
    Assign { target: Place, value: Expression },
    /// `PTP p`, `LIN p`, `CIRC through,to,CA angle`
    Move(Move),
    /// `WAIT SEC t`
    WaitSeconds(Expression),
    /// `WAIT FOR condition`
    WaitFor(Expression),
    /// `PULSE (output,level,seconds)`
    Pulse { output: Place, level: Expression, seconds: Expression },
    /// `HALT`: until the operator presses START.
    Halt,
    /// `RETURN`
    Return,
    /// `EXIT`: leaves the innermost `LOOP`.
    Exit,
    /// `NAME (arguments)`
    Call { name: String, arguments: Vec<Expression> },
    /// `FOR K=1 TO N STEP 1 .. ENDFOR`; without a step 1 is added.
    For { counter: Place, from: Expression, to: Expression, step: Option<Expression>, body: Block },
    /// `IF c THEN .. ELSE .. ENDIF`
    If { condition: Expression, then: Block, otherwise: Block },
    /// `WHILE c .. ENDWHILE`
    While { condition: Expression, body: Block },
    /// `LOOP .. ENDLOOP`
    Loop(Block),
    /// `INTERRUPT DECL n WHEN condition DO call`
    InterruptDeclaration { condition: Expression },
    /// `INTERRUPT ON n`, `INTERRUPT OFF n`
    InterruptSwitch,
}

impl StatementKind {
    pub(crate) fn blocks(&self) -> impl Iterator<Item = &Block> {
        let blocks = match self {
            Self::For { body, .. } | Self::While { body, .. } | Self::Loop(body) => [Some(body), None],
            Self::If { then, otherwise, .. } => [Some(then), Some(otherwise)],
            _ => [None, None],
        };
        blocks.into_iter().flatten()
    }
}

#[derive(Clone, Debug)]
pub struct Move {
    pub motion: Motion,
    /// The auxiliary point of an arc.
    pub through: Option<Expression>,
    /// An axis position or a Cartesian position.
    pub to: Expression,
    /// Signed sweep of an arc, degrees.
    pub angle: Option<Expression>,
    /// Approximate positioning (`C_PTP`, ..) as written.
    pub approximate: Option<String>,
}

/// A variable, or a part of one.
#[derive(Clone, Debug)]
pub struct Place {
    /// With its `$` if it has one.
    pub name: String,
    /// Elements and members, outermost first.
    pub parts: Vec<Part>,
    pub span: Span,
}

/// A step into a variable.
#[derive(Clone, Debug)]
pub enum Part {
    /// `[i]`, from 1.
    Element(Box<Expression>),
    /// `[]`: the whole array (of characters).
    Whole,
    /// `.NAME`
    Member(String),
}

#[derive(Clone, Debug)]
pub struct Expression {
    pub span: Span,
    pub kind: ExpressionKind,
}

#[derive(Clone, Debug)]
pub enum ExpressionKind {
    /// `10`, `'B0101'`, `'HFF'`
    Int(i64),
    /// `1.5`, `1.2E-5`
    Real(f64),
    Bool(bool),
    /// `#BASE`, without the `#`.
    Enum(String),
    /// `"text"`
    Text(String),
    Place(Place),
    /// `{X 1.0,Y 2.0}`, `{E6POS: X 1.0}`
    Aggregate(Vec<Field>),
    /// `NAME (a,b)`: a function of the controller, of which the `EKI_` ones are known.
    Call {
        name: String,
        arguments: Vec<Expression>,
    },
    /// `-a`, `NOT a`
    Unary(Unary, Box<Expression>),
    /// `a + b`, ..
    Binary(Binary, Box<Expression>, Box<Expression>),
}

/// A component of an aggregate.
#[derive(Clone, Debug)]
pub struct Field {
    pub name: String,
    pub value: Expression,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unary {
    Minus,
    Not,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Binary {
    Add,
    Subtract,
    Multiply,
    Divide,
    Equal,
    Unequal,
    Less,
    LessOrEqual,
    Greater,
    GreaterOrEqual,
    And,
    Or,
}

/// Types that declare without the word DECL.
pub(super) fn type_of_declaration(name: &str) -> bool {
    let types = ["INT", "REAL", "BOOL", "CHAR", "FRAME", "POS", "E6POS", "AXIS", "E6AXIS", "LOAD", "FDAT"];
    types.contains(&name)
}
