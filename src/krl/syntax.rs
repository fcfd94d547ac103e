//! The tree of a KRL program. Every node knows its bytes in the text, so that a reader can point at
//! them and a writer can replace them and nothing else.

use std::ops::Range;
use std::sync::Arc;

/// A range of bytes of the file's text.
pub type Span = Range<usize>;

/// A `.src` file.
#[derive(Clone, Debug)]
pub struct Source {
    /// The file as the user named it.
    pub file: String,
    /// Its text, which the spans point into.
    pub text: String,
    /// The routines in order; the first is the module's own.
    pub routines: Vec<Routine>,
}

/// `DEF .. END`.
#[derive(Clone, Debug)]
pub struct Routine {
    /// Name in capitals.
    pub name: String,
    /// Where the name stands.
    pub span: Span,
    /// Names of its parameters, in capitals; all are `:IN`.
    pub parameters: Vec<String>,
    /// What it declares, before its first statement.
    pub declarations: Vec<Declaration>,
    /// What it does.
    pub body: Block,
}

/// Statements in order; shared, so that an executor can hold its place in them.
pub type Block = Arc<[Statement]>;

/// A `.dat` file.
#[derive(Clone, Debug)]
pub struct Data {
    /// The file as the user named it.
    pub file: String,
    /// Its text, which the spans point into.
    pub text: String,
    /// Name in capitals.
    pub name: String,
    /// What it declares and initialises, in order.
    pub items: Vec<DataItem>,
}

/// A line of a `.dat` file.
#[derive(Clone, Debug)]
pub enum DataItem {
    /// A declaration, with or without a value.
    Declaration(Declaration),
    /// A value for an element of an array declared before.
    Value {
        /// The element.
        target: Place,
        /// Its value.
        value: Expression,
    },
}

/// A declaration.
#[derive(Clone, Debug)]
pub struct Declaration {
    /// The bytes of the line's content.
    pub span: Span,
    /// What is declared.
    pub kind: DeclarationKind,
}

/// What is declared.
#[derive(Clone, Debug)]
pub enum DeclarationKind {
    /// `DECL INT A,B[3]=..`
    Variables {
        /// Name of the type, in capitals.
        type_name: String,
        /// The variables.
        names: Vec<Declared>,
    },
    /// `SIGNAL NAME $OUT[9] TO $OUT[16]`
    Signal {
        /// Name in capitals.
        name: String,
        /// First input or output.
        first: Place,
        /// Last one, where there are several.
        last: Option<Place>,
    },
    /// `EXT NAME (..)`: a module elsewhere.
    External {
        /// Name in capitals.
        name: String,
    },
}

/// One declared variable.
#[derive(Clone, Debug)]
pub struct Declared {
    /// Name in capitals.
    pub name: String,
    /// Number of elements, for an array.
    pub elements: Option<usize>,
    /// Initial value.
    pub value: Option<Expression>,
    /// Where it stands.
    pub span: Span,
}

/// A statement.
#[derive(Clone, Debug)]
pub struct Statement {
    /// Its bytes, up to the end of its first line.
    pub span: Span,
    /// What it does.
    pub kind: StatementKind,
}

/// What a statement does.
#[derive(Clone, Debug)]
pub enum StatementKind {
    /// `A=B`
    Assign {
        /// What is set.
        target: Place,
        /// To what.
        value: Expression,
    },
    /// `PTP p`, all axes together.
    Ptp {
        /// Where to: an axis or a Cartesian position.
        to: Expression,
        /// Approximate positioning (`C_PTP`, ..) as written, in capitals.
        approximate: Option<String>,
    },
    /// `LIN p`, on a straight line.
    Lin {
        /// Where to.
        to: Expression,
        /// As for [`StatementKind::Ptp`].
        approximate: Option<String>,
    },
    /// `CIRC through,to,CA angle`, on an arc.
    Circ {
        /// Auxiliary point.
        through: Expression,
        /// Where to.
        to: Expression,
        /// Signed sweep, degrees.
        angle: Option<Expression>,
        /// As for [`StatementKind::Ptp`].
        approximate: Option<String>,
    },
    /// `WAIT SEC t`
    WaitSeconds(Expression),
    /// `WAIT FOR condition`
    WaitFor(Expression),
    /// `PULSE (output,level,seconds)`
    Pulse {
        /// The output.
        output: Place,
        /// Its level during the pulse.
        level: Expression,
        /// How long, s.
        seconds: Expression,
    },
    /// `HALT`: until the operator presses START.
    Halt,
    /// `RETURN`
    Return,
    /// `EXIT`: leaves the innermost `LOOP`.
    Exit,
    /// `NAME (arguments)`
    Call {
        /// Name in capitals.
        name: String,
        /// Arguments in order.
        arguments: Vec<Expression>,
    },
    /// `FOR K=1 TO N STEP 1 .. ENDFOR`
    For {
        /// The counter.
        counter: Place,
        /// Its first value.
        from: Expression,
        /// Its last value.
        to: Expression,
        /// What is added each time; 1 when absent.
        step: Option<Expression>,
        /// What is repeated.
        body: Block,
    },
    /// `IF c THEN .. ELSE .. ENDIF`
    If {
        /// The condition.
        condition: Expression,
        /// When it holds.
        then: Block,
        /// When it does not.
        otherwise: Block,
    },
    /// `WHILE c .. ENDWHILE`
    While {
        /// The condition.
        condition: Expression,
        /// What is repeated.
        body: Block,
    },
    /// `LOOP .. ENDLOOP`
    Loop(Block),
    /// `INTERRUPT DECL n WHEN condition DO call`
    InterruptDeclaration {
        /// When it fires.
        condition: Expression,
    },
    /// `INTERRUPT ON n`, `INTERRUPT OFF n`
    InterruptSwitch,
}

/// A variable, or a part of one.
#[derive(Clone, Debug)]
pub struct Place {
    /// Name in capitals, with its `$` if it has one.
    pub name: String,
    /// Elements and members, outermost first.
    pub parts: Vec<Part>,
    /// Where it stands.
    pub span: Span,
}

/// A step into a variable.
#[derive(Clone, Debug)]
pub enum Part {
    /// `[i]`, from 1.
    Element(Box<Expression>),
    /// `[]`: the whole array (of characters).
    Whole,
    /// `.NAME`, in capitals.
    Member(String),
}

/// An expression.
#[derive(Clone, Debug)]
pub struct Expression {
    /// Where it stands.
    pub span: Span,
    /// What it is.
    pub kind: ExpressionKind,
}

/// What an expression is.
#[derive(Clone, Debug)]
pub enum ExpressionKind {
    /// `10`, `'B0101'`, `'HFF'`
    Int(i64),
    /// `1.5`, `1.2E-5`
    Real(f64),
    /// `TRUE`, `FALSE`
    Bool(bool),
    /// `#BASE`, in capitals without the `#`.
    Enum(String),
    /// `"text"`
    Text(String),
    /// A variable or a part of one.
    Place(Place),
    /// `{X 1.0,Y 2.0}`, `{E6POS: X 1.0}`
    Aggregate(Vec<Field>),
    /// `NAME (a,b)`: a function of the controller, of which the `EKI_` ones are known.
    Call {
        /// Name in capitals.
        name: String,
        /// Arguments in order.
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
    /// Name in capitals.
    pub name: String,
    /// Its value.
    pub value: Expression,
}

/// Operators before an operand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unary {
    /// `-`
    Minus,
    /// `NOT`
    Not,
}

/// Operators between operands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // the names say it
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
    matches!(name, "INT" | "REAL" | "BOOL" | "CHAR" | "FRAME" | "POS" | "E6POS" | "AXIS" | "E6AXIS" | "LOAD")
}
