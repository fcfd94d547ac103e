//! The syntax tree of a KRL program. Nodes carry their bytes in the text, so that a diagnostic can point at them and a
//! correction can replace them and nothing else. Names are in capitals.

use std::sync::Arc;

use crate::plan::MotionKind;
pub use crate::program::text::{Span, Text};

/// A `.src` file.
#[derive(Clone, Debug)]
pub struct Source {
    pub file: String,
    pub text: String,
    /// The routines, in the order of the text; the first one is the module's own.
    pub routines: Vec<Routine>,
}

impl Source {
    pub(crate) fn as_text(&self) -> Text<'_> {
        Text { file: &self.file, text: &self.text }
    }
}

/// `DEF .. END`
#[derive(Clone, Debug)]
pub struct Routine {
    pub name: String,
    /// The bytes of the name.
    pub span: Span,
    /// All are passed by value (`:IN`).
    pub parameters: Vec<String>,
    pub declarations: Vec<Declaration>,
    pub body: Block,
}

/// A sequence of statements; shared, so that an interpreter can hold its position in it.
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
    /// `A=B` or `A[1]=B`
    Value {
        target: Place,
        value: Expression,
    },
}

#[derive(Clone, Debug)]
pub enum Declaration {
    /// `DECL INT A,B[3]=..`
    Variables { type_name: String, variables: Vec<Declared> },
    /// `SIGNAL NAME $OUT[9] TO $OUT[16]`
    Signal { name: String, first: Place, last: Option<Place> },
    /// `EXT NAME (..)`: a routine of another module.
    External { name: String },
}

impl Declaration {
    pub(crate) fn variables(&self) -> &[Declared] {
        match self {
            Self::Variables { variables, .. } => variables,
            Self::Signal { .. } | Self::External { .. } => &[],
        }
    }
}

#[derive(Clone, Debug)]
pub struct Declared {
    pub name: String,
    /// Number of elements of an array.
    pub elements: Option<usize>,
    pub value: Option<Expression>,
    pub span: Span,
}

#[derive(Clone, Debug)]
pub struct Statement {
    /// The bytes of the first line of the statement.
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
    /// `HALT`: stops until the operator presses START.
    Halt,
    /// `RETURN`
    Return,
    /// `EXIT`: out of the innermost `LOOP`.
    Exit,
    /// `NAME (arguments)`
    Call { name: String, arguments: Vec<Expression> },
    /// `FOR K=1 TO N STEP 1 .. ENDFOR`; the default step is 1.
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
    /// The blocks inside the statement.
    pub(crate) fn blocks(&self) -> impl Iterator<Item = &Block> {
        let blocks = match self {
            Self::For { body, .. } | Self::While { body, .. } | Self::Loop(body) => [Some(body), None],
            Self::If { then, otherwise, .. } => [Some(then), Some(otherwise)],
            Self::Assign { .. }
            | Self::Move(_)
            | Self::WaitSeconds(_)
            | Self::WaitFor(_)
            | Self::Pulse { .. }
            | Self::Halt
            | Self::Return
            | Self::Exit
            | Self::Call { .. }
            | Self::InterruptDeclaration { .. }
            | Self::InterruptSwitch => [None, None],
        };
        blocks.into_iter().flatten()
    }
}

#[derive(Clone, Debug)]
pub struct Move {
    pub motion: MotionKind,
    /// The auxiliary point of an arc.
    pub through: Option<Expression>,
    /// An axis position or a Cartesian position.
    pub to: Expression,
    /// `CA`: signed sweep of an arc, degrees.
    pub angle: Option<Expression>,
    /// `C_PTP`, `C_DIS`, ..: approximate positioning.
    pub approximate: Option<String>,
}

/// A variable, or an element or component of one.
#[derive(Clone, Debug)]
pub struct Place {
    /// Name of the variable, with the `$` of a system variable.
    pub name: String,
    /// The indices and components, the outermost first.
    pub parts: Vec<Part>,
    pub span: Span,
}

#[derive(Clone, Debug)]
pub enum Part {
    /// `[i]`, from 1.
    Element(Box<Expression>),
    /// `[]`: the whole array, of characters.
    Whole,
    /// `.NAME`
    Component(String),
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
    /// `NAME (a,b)`: a function of EthernetKRL (`EKI_..`); no others are supported.
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

/// Whether a type may begin a declaration without the word DECL.
pub(super) fn declares_without_decl(name: &str) -> bool {
    let types = ["INT", "REAL", "BOOL", "CHAR", "FRAME", "POS", "E6POS", "AXIS", "E6AXIS", "LOAD", "FDAT"];
    types.contains(&name)
}
