//! One way to ask SQLite and PostgreSQL: the same statements, with `$1`, `$2`, .. for their values.
//!
//! What the two write differently has a name in braces: `{now}`, `{user}`, `{skip_locked}`.

use std::error::Error as _;
use std::time::Duration;

use postgres::types::{IsNull, ToSql, Type, private::BytesMut, to_sql_checked};
use rusqlite::types::ValueRef;

use super::address::DatabaseAddress;
use crate::catalogue::ArchiveFinding::{NotAValue, NotReached, Refused};
use crate::diagnostic::Diagnostic;

/// How long SQLite waits for another process that writes.
const PATIENCE: Duration = Duration::from_secs(60);
/// Where the tables are in PostgreSQL.
const SCHEMA: &str = "dbbd";

/// A value of a statement or of a row.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value {
    Null,
    Int(i64),
    Real(f64),
    Text(String),
}

impl From<i64> for Value {
    fn from(value: i64) -> Self {
        Self::Int(value)
    }
}

impl From<u64> for Value {
    fn from(value: u64) -> Self {
        Self::Int(i64::try_from(value).unwrap_or(i64::MAX))
    }
}

impl From<f64> for Value {
    fn from(value: f64) -> Self {
        Self::Real(value)
    }
}

impl From<&str> for Value {
    fn from(value: &str) -> Self {
        // PostgreSQL has no text with this character.
        Self::Text(value.replace('\0', ""))
    }
}

impl From<&String> for Value {
    fn from(value: &String) -> Self {
        value.as_str().into()
    }
}

impl<T: Into<Value>> From<Option<T>> for Value {
    fn from(value: Option<T>) -> Self {
        value.map_or(Self::Null, Into::into)
    }
}

/// A row of an answer.
#[derive(Debug)]
pub(super) struct Row(Vec<Value>);

impl Row {
    pub(super) fn text(&self, column: usize) -> Result<String, Diagnostic> {
        self.some_text(column)?.ok_or_else(|| NotAValue { column }.into())
    }

    pub(super) fn some_text(&self, column: usize) -> Result<Option<String>, Diagnostic> {
        match self.0.get(column) {
            Some(Value::Text(text)) => Ok(Some(text.clone())),
            Some(Value::Null) => Ok(None),
            _ => Err(NotAValue { column }.into()),
        }
    }

    pub(super) fn int(&self, column: usize) -> Result<i64, Diagnostic> {
        match self.0.get(column) {
            Some(Value::Int(value)) => Ok(*value),
            _ => Err(NotAValue { column }.into()),
        }
    }

    pub(super) fn count(&self, column: usize) -> Result<u64, Diagnostic> {
        u64::try_from(self.int(column)?).map_err(|_| NotAValue { column }.into())
    }

    pub(super) fn some_real(&self, column: usize) -> Result<Option<f64>, Diagnostic> {
        match self.0.get(column) {
            Some(Value::Real(value)) => Ok(Some(*value)),
            Some(Value::Int(value)) => Ok(Some(*value as f64)),
            Some(Value::Null) => Ok(None),
            _ => Err(NotAValue { column }.into()),
        }
    }
}

/// A connection.
pub enum Database {
    Sqlite(rusqlite::Connection),
    Postgres(Box<postgres::Client>),
}

fn lite(error: rusqlite::Error) -> Diagnostic {
    Refused { why: error.to_string() }.into()
}

/// What PostgreSQL says, without the statement's values. A connection that is gone is one that cannot be reached.
fn big(error: postgres::Error) -> Diagnostic {
    use postgres::error::SqlState;
    if let Some(said) = error.as_db_error() {
        let over = [SqlState::ADMIN_SHUTDOWN, SqlState::CRASH_SHUTDOWN, SqlState::CANNOT_CONNECT_NOW];
        let why = format!("{} ({})", said.message(), said.code().code());
        return if over.contains(said.code()) { gone(why) } else { Refused { why }.into() };
    }
    let why = error.source().map_or_else(|| error.to_string(), |source| format!("{error}: {source}"));
    if error.is_closed() || error.source().is_some_and(|source| source.is::<std::io::Error>()) {
        return gone(why);
    }
    Refused { why }.into()
}

fn gone(why: String) -> Diagnostic {
    NotReached { what: "the database".into(), why }.into()
}

impl Database {
    pub(super) fn open(address: &DatabaseAddress) -> Result<Self, Diagnostic> {
        match address {
            DatabaseAddress::Sqlite(path) => {
                let connection = rusqlite::Connection::open(path).map_err(|error| gone(error.to_string()))?;
                connection.busy_timeout(PATIENCE).map_err(lite)?;
                let set = "PRAGMA journal_mode = WAL; PRAGMA synchronous = FULL; PRAGMA foreign_keys = ON;";
                connection.execute_batch(set).map_err(lite)?;
                Ok(Self::Sqlite(connection))
            }
            DatabaseAddress::Postgres(config, root) => {
                let connected = match root {
                    Some(root) => config.connect(super::tls::connector(root)?),
                    None => config.connect(postgres::NoTls),
                };
                let why = |error: postgres::Error| {
                    let said = error.as_db_error().map(|said| said.message().to_owned());
                    let source = error.source().map(|source| format!("{error}: {source}"));
                    gone(said.or(source).unwrap_or_else(|| error.to_string()))
                };
                let mut client = connected.map_err(why)?;
                client.batch_execute(&format!("SET search_path TO {SCHEMA}")).map_err(big)?;
                Ok(Self::Postgres(Box::new(client)))
            }
        }
    }

    pub(super) fn is_postgres(&self) -> bool {
        matches!(self, Self::Postgres(_))
    }

    fn dialect(&self, sql: &str) -> String {
        let [now, user, skip] = match self {
            Self::Sqlite(_) => ["CAST(unixepoch('subsec') * 1000 AS INTEGER)", "''", ""],
            Self::Postgres(_) => [
                "CAST(extract(epoch FROM clock_timestamp()) * 1000 AS BIGINT)",
                "current_user",
                "FOR UPDATE SKIP LOCKED",
            ],
        };
        sql.replace("{now}", now).replace("{user}", user).replace("{skip_locked}", skip)
    }

    /// Statements without values.
    pub(super) fn batch(&mut self, sql: &str) -> Result<(), Diagnostic> {
        let sql = self.dialect(sql);
        match self {
            Self::Sqlite(connection) => connection.execute_batch(&sql).map_err(lite),
            Self::Postgres(client) => client.batch_execute(&sql).map_err(big),
        }
    }

    /// How many rows a statement changed.
    pub(super) fn execute(&mut self, sql: &str, values: &[Value]) -> Result<u64, Diagnostic> {
        let sql = self.dialect(sql);
        match self {
            Self::Sqlite(connection) => {
                let mut statement = connection.prepare(&sql).map_err(lite)?;
                bind(&mut statement, values)?;
                statement.raw_execute().map(|rows| rows as u64).map_err(lite)
            }
            Self::Postgres(client) => client.execute(&sql, &of_postgres(values)).map_err(big),
        }
    }

    /// The rows that answer a statement.
    pub(super) fn query(&mut self, sql: &str, values: &[Value]) -> Result<Vec<Row>, Diagnostic> {
        let sql = self.dialect(sql);
        match self {
            Self::Sqlite(connection) => {
                let mut statement = connection.prepare(&sql).map_err(lite)?;
                bind(&mut statement, values)?;
                let columns = statement.column_count();
                let (mut rows, mut found) = (statement.raw_query(), Vec::new());
                while let Some(row) = rows.next().map_err(lite)? {
                    let value = |at| row.get_ref(at).map(of_sqlite).map_err(lite);
                    found.push(Row((0..columns).map(value).collect::<Result<_, _>>()?));
                }
                Ok(found)
            }
            Self::Postgres(client) => {
                let rows = client.query(&sql, &of_postgres(values)).map_err(big)?;
                rows.iter()
                    .map(|row| (0..row.len()).map(|at| column(row, at)).collect::<Result<_, _>>())
                    .map(|row| row.map(Row))
                    .collect()
            }
        }
    }

    /// All of `work` or nothing of it. SQLite lets no other process write from its begin.
    pub(super) fn transaction<T>(
        &mut self,
        work: impl FnOnce(&mut Self) -> Result<T, Diagnostic>,
    ) -> Result<T, Diagnostic> {
        self.batch(if self.is_postgres() { "BEGIN" } else { "BEGIN IMMEDIATE" })?;
        let done = work(self).and_then(|done| self.batch("COMMIT").map(|()| done));
        if done.is_err() {
            // Where the connection is gone, the database does so itself.
            let _ = self.batch("ROLLBACK");
        }
        done
    }
}

/// SQLite numbers `$1`, `$2`, .. in the order in which they appear; they are bound by name.
fn bind(statement: &mut rusqlite::Statement<'_>, values: &[Value]) -> Result<(), Diagnostic> {
    for (at, value) in values.iter().enumerate() {
        let Some(index) = statement.parameter_index(&format!("${}", at + 1)).map_err(lite)? else { continue };
        match value {
            Value::Null => statement.raw_bind_parameter(index, rusqlite::types::Null),
            Value::Int(value) => statement.raw_bind_parameter(index, value),
            Value::Real(value) => statement.raw_bind_parameter(index, value),
            Value::Text(value) => statement.raw_bind_parameter(index, value),
        }
        .map_err(lite)?;
    }
    Ok(())
}

fn of_sqlite(value: ValueRef<'_>) -> Value {
    match value {
        ValueRef::Integer(value) => Value::Int(value),
        ValueRef::Real(value) => Value::Real(value),
        ValueRef::Text(value) | ValueRef::Blob(value) => {
            Value::Text(String::from_utf8_lossy(value).into_owned())
        }
        ValueRef::Null => Value::Null,
    }
}

fn of_postgres(values: &[Value]) -> Vec<&(dyn ToSql + Sync)> {
    values.iter().map(|value| value as &(dyn ToSql + Sync)).collect()
}

fn column(row: &postgres::Row, at: usize) -> Result<Value, Diagnostic> {
    let value = match *row.columns().get(at).map_or(&Type::UNKNOWN, |column| column.type_()) {
        Type::INT8 => row.try_get::<_, Option<i64>>(at).map(Value::from),
        Type::INT4 => row.try_get::<_, Option<i32>>(at).map(|value| value.map(i64::from).into()),
        Type::FLOAT8 => row.try_get::<_, Option<f64>>(at).map(Value::from),
        Type::BOOL => row.try_get::<_, Option<bool>>(at).map(|value| value.map(i64::from).into()),
        _ => row.try_get::<_, Option<&str>>(at).map(Value::from),
    };
    value.map_err(big)
}

impl ToSql for Value {
    fn to_sql(
        &self,
        kind: &Type,
        out: &mut BytesMut,
    ) -> Result<IsNull, Box<dyn std::error::Error + Sync + Send>> {
        match self {
            Self::Null => Ok(IsNull::Yes),
            Self::Int(value) if *kind == Type::FLOAT8 => (*value as f64).to_sql(kind, out),
            Self::Int(value) if *kind == Type::INT4 => i32::try_from(*value)?.to_sql(kind, out),
            Self::Int(value) => value.to_sql(kind, out),
            Self::Real(value) => value.to_sql(kind, out),
            Self::Text(value) => value.to_sql(kind, out),
        }
    }

    fn accepts(kind: &Type) -> bool {
        [Type::INT8, Type::INT4, Type::FLOAT8, Type::TEXT, Type::VARCHAR, Type::NAME].contains(kind)
    }

    to_sql_checked!();
}
