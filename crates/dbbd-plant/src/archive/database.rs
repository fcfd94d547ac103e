//! SQLite and PostgreSQL with the same SQL statements, whose parameters are `$1`, `$2`, ..
//!
//! Expressions that differ between the two have a name in braces: `{now}`, `{user}`, `{skip_locked}`. Parameters and
//! rows are JSON values, so that serde converts them.

use std::error::Error as _;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use postgres::types::{IsNull, ToSql, Type, private::BytesMut, to_sql_checked};
use rusqlite::types::ValueRef;
use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::PemObject as _;
use rustls::{ClientConfig, RootCertStore};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use tokio_postgres_rustls::MakeRustlsConnect;

use super::address::DatabaseAddress;
use crate::ArchiveFinding::{NotAValue, NotAnAddress, NotReached, Refused};
use dbbd_model::diagnostic::Diagnostic;

/// Longest wait of SQLite for another process that writes.
const BUSY_TIMEOUT: Duration = Duration::from_secs(60);
/// The schema of the tables in PostgreSQL.
const POSTGRES_SCHEMA: &str = "dbbd";

/// A connection.
pub enum Database {
    Sqlite(rusqlite::Connection),
    Postgres(Box<postgres::Client>),
}

/// Column names and rows.
type TableDump = (Vec<String>, Vec<Vec<Value>>);

fn sqlite_error(error: rusqlite::Error) -> Diagnostic {
    Refused { why: error.to_string() }.into()
}

/// The message of PostgreSQL without the statement's parameters. A lost connection counts as unreachable.
fn postgres_error(error: postgres::Error) -> Diagnostic {
    use postgres::error::SqlState;
    if let Some(message) = error.as_db_error() {
        let over = [SqlState::ADMIN_SHUTDOWN, SqlState::CRASH_SHUTDOWN, SqlState::CANNOT_CONNECT_NOW];
        let why = format!("{} ({})", message.message(), message.code().code());
        return if over.contains(message.code()) { unreachable(why) } else { Refused { why }.into() };
    }
    let why = error.source().map_or_else(|| error.to_string(), |source| format!("{error}: {source}"));
    if error.is_closed() || error.source().is_some_and(|source| source.is::<std::io::Error>()) {
        return unreachable(why);
    }
    Refused { why }.into()
}

fn unreachable(why: String) -> Diagnostic {
    NotReached { what: "the database".into(), why }.into()
}

impl Database {
    pub(super) fn open(address: &DatabaseAddress) -> Result<Self, Diagnostic> {
        match address {
            DatabaseAddress::Sqlite(path) => {
                let connection =
                    rusqlite::Connection::open(path).map_err(|error| unreachable(error.to_string()))?;
                connection.busy_timeout(BUSY_TIMEOUT).map_err(sqlite_error)?;
                let set = "PRAGMA journal_mode = WAL; PRAGMA synchronous = FULL; PRAGMA foreign_keys = ON;";
                connection.execute_batch(set).map_err(sqlite_error)?;
                Ok(Self::Sqlite(connection))
            }
            DatabaseAddress::Postgres(config, root) => {
                let connected = match root {
                    Some(root) => config.connect(tls(root)?),
                    None => config.connect(postgres::NoTls),
                };
                let mut client = connected.map_err(|error| {
                    let message = error.as_db_error().map(|error| error.message().to_owned());
                    let source = error.source().map(|source| format!("{error}: {source}"));
                    unreachable(message.or(source).unwrap_or_else(|| error.to_string()))
                })?;
                client
                    .batch_execute(&format!("SET search_path TO {POSTGRES_SCHEMA}"))
                    .map_err(postgres_error)?;
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

    /// Executes statements without parameters.
    pub(super) fn batch(&mut self, sql: &str) -> Result<(), Diagnostic> {
        let sql = self.dialect(sql);
        match self {
            Self::Sqlite(connection) => connection.execute_batch(&sql).map_err(sqlite_error),
            Self::Postgres(client) => client.batch_execute(&sql).map_err(postgres_error),
        }
    }

    /// Executes a statement with a tuple or list of parameters, and returns the number of changed rows.
    pub(super) fn execute(&mut self, sql: &str, parameters: impl Serialize) -> Result<u64, Diagnostic> {
        let (sql, parameters) = (self.dialect(sql), bound(parameters)?);
        match self {
            Self::Sqlite(connection) => {
                let mut statement = connection.prepare(&sql).map_err(sqlite_error)?;
                bind(&mut statement, &parameters)?;
                statement.raw_execute().map(|rows| rows as u64).map_err(sqlite_error)
            }
            Self::Postgres(client) => client.execute(&sql, &references(&parameters)).map_err(postgres_error),
        }
    }

    /// Inserts a row with a column per field, unless its key exists. Returns whether it was inserted. `now` is a column
    /// for the present time.
    pub(super) fn insert(
        &mut self,
        table: &str,
        row: impl Serialize,
        now: Option<&str>,
    ) -> Result<bool, Diagnostic> {
        let Value::Object(row) = serde_json::to_value(row).map_err(|error| not_a_value(&error))? else {
            return Err(NotAValue { why: format!("a row of {table} is no object") }.into());
        };
        let (mut columns, parameters): (Vec<String>, Vec<Value>) = row.into_iter().unzip();
        let mut values: Vec<String> = (1..=columns.len()).map(|at| format!("${at}")).collect();
        if let Some(now) = now {
            columns.push(now.into());
            values.push("{now}".into());
        }
        let (columns, values) = (columns.join(", "), values.join(", "));
        let sql = format!("INSERT INTO {table} ({columns}) VALUES ({values}) ON CONFLICT DO NOTHING");
        Ok(self.execute(&sql, parameters)? == 1)
    }

    /// The rows as structs whose fields have the names of the columns.
    pub(super) fn query<T: DeserializeOwned>(
        &mut self,
        sql: &str,
        parameters: impl Serialize,
    ) -> Result<Vec<T>, Diagnostic> {
        let (names, rows) = self.table(sql, parameters)?;
        rows.into_iter().map(|row| deserialize_row(names.iter().cloned().zip(row).collect())).collect()
    }

    /// The rows as tuples, or as plain values if there is one column.
    pub(super) fn tuples<T: DeserializeOwned>(
        &mut self,
        sql: &str,
        parameters: impl Serialize,
    ) -> Result<Vec<T>, Diagnostic> {
        let (names, rows) = self.table(sql, parameters)?;
        let row = |mut row: Vec<Value>| match row.pop() {
            Some(only) if names.len() == 1 => deserialize_row(only),
            last => deserialize_row(row.into_iter().chain(last).collect()),
        };
        rows.into_iter().map(row).collect()
    }

    fn table(&mut self, sql: &str, parameters: impl Serialize) -> Result<TableDump, Diagnostic> {
        let (sql, parameters) = (self.dialect(sql), bound(parameters)?);
        match self {
            Self::Sqlite(connection) => {
                let mut statement = connection.prepare(&sql).map_err(sqlite_error)?;
                bind(&mut statement, &parameters)?;
                let names: Vec<String> = statement.column_names().map(str::to_owned).collect();
                let (mut cursor, mut rows) = (statement.raw_query(), Vec::new());
                while let Some(row) = cursor.next().map_err(sqlite_error)? {
                    let value = |at| row.get_ref(at).map(of_sqlite).map_err(sqlite_error);
                    rows.push((0..names.len()).map(value).collect::<Result<_, _>>()?);
                }
                Ok((names, rows))
            }
            Self::Postgres(client) => {
                let statement = client.prepare(&sql).map_err(postgres_error)?;
                let names = statement.columns().iter().map(|column| column.name().to_owned()).collect();
                let rows = client.query(&statement, &references(&parameters)).map_err(postgres_error)?;
                let row = |row: &postgres::Row| (0..row.len()).map(|at| of_postgres(row, at)).collect();
                Ok((names, rows.iter().map(row).collect::<Result<_, _>>()?))
            }
        }
    }

    /// Commits all of `work`, or nothing on an error. SQLite admits no other writer from the begin on.
    pub(super) fn transaction<T>(
        &mut self,
        work: impl FnOnce(&mut Self) -> Result<T, Diagnostic>,
    ) -> Result<T, Diagnostic> {
        self.batch(if self.is_postgres() { "BEGIN" } else { "BEGIN IMMEDIATE" })?;
        let done = work(self).and_then(|done| self.batch("COMMIT").map(|()| done));
        if done.is_err() {
            // After a lost connection the database rolls back by itself.
            let _ = self.batch("ROLLBACK");
        }
        done
    }
}

fn not_a_value(error: &serde_json::Error) -> Diagnostic {
    NotAValue { why: error.to_string() }.into()
}

fn deserialize_row<T: DeserializeOwned>(row: Value) -> Result<T, Diagnostic> {
    serde_json::from_value(row).map_err(|error| not_a_value(&error))
}

/// A parameter of a statement: null, a number, a flag or a text.
#[derive(Debug)]
struct SqlParameter(Value);

fn bound(parameters: impl Serialize) -> Result<Vec<SqlParameter>, Diagnostic> {
    let parameters = match serde_json::to_value(parameters).map_err(|error| not_a_value(&error))? {
        Value::Array(parameters) => parameters,
        Value::Null => Vec::new(),
        only @ (Value::Bool(_) | Value::Number(_) | Value::String(_) | Value::Object(_)) => vec![only],
    };
    // PostgreSQL has no text with this character.
    let sound = |parameter| {
        if let Value::String(text) = parameter {
            SqlParameter(text.replace('\0', "").into())
        } else {
            SqlParameter(parameter)
        }
    };
    Ok(parameters.into_iter().map(sound).collect())
}

fn references(parameters: &[SqlParameter]) -> Vec<&(dyn ToSql + Sync)> {
    parameters.iter().map(|parameter| parameter as &(dyn ToSql + Sync)).collect()
}

/// SQLite numbers `$1`, `$2`, .. in the order in which they appear, so they are bound by name.
fn bind(statement: &mut rusqlite::Statement<'_>, parameters: &[SqlParameter]) -> Result<(), Diagnostic> {
    for (at, SqlParameter(value)) in parameters.iter().enumerate() {
        let index = statement.parameter_index(&format!("${}", at + 1)).map_err(sqlite_error)?;
        let Some(index) = index else { continue };
        match value {
            Value::String(text) => statement.raw_bind_parameter(index, text),
            Value::Bool(flag) => statement.raw_bind_parameter(index, flag),
            Value::Number(number) => match number.as_i64() {
                Some(integer) => statement.raw_bind_parameter(index, integer),
                None => statement.raw_bind_parameter(index, number.as_f64()),
            },
            Value::Null | Value::Array(_) | Value::Object(_) => {
                statement.raw_bind_parameter(index, rusqlite::types::Null)
            }
        }
        .map_err(sqlite_error)?;
    }
    Ok(())
}

fn of_sqlite(value: ValueRef<'_>) -> Value {
    match value {
        ValueRef::Integer(value) => value.into(),
        ValueRef::Real(value) => value.into(),
        ValueRef::Text(value) | ValueRef::Blob(value) => String::from_utf8_lossy(value).into(),
        ValueRef::Null => Value::Null,
    }
}

fn of_postgres(row: &postgres::Row, at: usize) -> Result<Value, Diagnostic> {
    let value = match *row.columns().get(at).map_or(&Type::UNKNOWN, |column| column.type_()) {
        Type::INT8 => row.try_get::<_, Option<i64>>(at).map(Value::from),
        Type::INT4 => row.try_get::<_, Option<i32>>(at).map(Value::from),
        Type::FLOAT8 => row.try_get::<_, Option<f64>>(at).map(Value::from),
        Type::BOOL => row.try_get::<_, Option<bool>>(at).map(Value::from),
        _ => row.try_get::<_, Option<&str>>(at).map(Value::from),
    };
    value.map_err(postgres_error)
}

impl ToSql for SqlParameter {
    fn to_sql(
        &self,
        kind: &Type,
        out: &mut BytesMut,
    ) -> Result<IsNull, Box<dyn std::error::Error + Sync + Send>> {
        match &self.0 {
            Value::String(text) => text.to_sql(kind, out),
            Value::Number(number) if *kind == Type::FLOAT8 => number.as_f64().to_sql(kind, out),
            Value::Number(number) if *kind == Type::INT4 => {
                number.as_i64().map(i32::try_from).transpose()?.to_sql(kind, out)
            }
            Value::Number(number) => number.as_i64().to_sql(kind, out),
            Value::Bool(flag) => i64::from(*flag).to_sql(kind, out),
            Value::Null | Value::Array(_) | Value::Object(_) => Ok(IsNull::Yes),
        }
    }

    fn accepts(kind: &Type) -> bool {
        [Type::INT8, Type::INT4, Type::FLOAT8, Type::TEXT, Type::VARCHAR, Type::NAME].contains(kind)
    }

    to_sql_checked!();
}

/// TLS for PostgreSQL: the certificate chain and the host name are verified. Trusts the authority in the PEM file
/// `root` and no other.
fn tls(root: &Path) -> Result<MakeRustlsConnect, Diagnostic> {
    let wrong = |why: String| {
        Diagnostic::file(root.display().to_string(), NotAnAddress { option: "sslrootcert".into(), why })
    };
    let mut roots = RootCertStore::empty();
    for certificate in CertificateDer::pem_file_iter(root).map_err(|error| wrong(error.to_string()))? {
        let certificate = certificate.map_err(|error| wrong(error.to_string()))?;
        roots.add(certificate).map_err(|error| wrong(error.to_string()))?;
    }
    if roots.is_empty() {
        return Err(wrong("there is no certificate in it".into()));
    }
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .map_err(|error| wrong(error.to_string()))?
        .with_root_certificates(roots)
        .with_no_client_auth();
    Ok(MakeRustlsConnect::new(config))
}
