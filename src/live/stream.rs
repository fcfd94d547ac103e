//! The live stream: server-sent events. A client that reads too slowly loses messages and receives their number.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::time::Duration;

use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use futures_util::stream;
use serde_json::json;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::{broadcast, watch};

use super::server::Busy;
use super::service::Service;
use super::view::Message;

/// A comment is sent after this silence, so that a broken connection is noticed.
const KEEP_ALIVE: Duration = Duration::from_secs(5);

struct Stream {
    /// The state when the client connected.
    first: VecDeque<Message>,
    messages: broadcast::Receiver<Message>,
    stop: watch::Receiver<bool>,
    _busy: Busy,
}

/// First the state, the points and the readings so far, then the messages.
pub(super) fn answer(service: &dyn Service, stop: watch::Receiver<bool>, busy: Busy) -> Response {
    // Subscribe before reading the points: no point is lost, one may come twice.
    let messages = service.messages();
    let status = Message::new("status", &*service.status().borrow());
    let points = Message::new("points", &service.points());
    let first = VecDeque::from([status, points, Message::new("trace", &service.trace())]);
    let stream = Stream { first, messages, stop, _busy: busy };
    let events = stream::unfold(stream, |mut stream| async move {
        let message = stream.next().await?;
        let event = Event::default().event(message.event).data(&*message.data);
        Some((Ok::<_, Infallible>(event), stream))
    });
    Sse::new(events).keep_alive(KeepAlive::new().interval(KEEP_ALIVE)).into_response()
}

impl Stream {
    async fn next(&mut self) -> Option<Message> {
        if let Some(message) = self.first.pop_front() {
            return Some(message);
        }
        // An open stream would delay the shutdown.
        let received = tokio::select! {
            _ = self.stop.wait_for(|stop| *stop) => return None,
            received = self.messages.recv() => received,
        };
        match received {
            Ok(message) => Some(message),
            Err(RecvError::Lagged(lost)) => Some(Message::new("lost", &json!({ "messages": lost }))),
            Err(RecvError::Closed) => None,
        }
    }
}
