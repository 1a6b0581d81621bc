//! Connections: how many, how long they may take to say what they want.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio_rustls::TlsAcceptor;

/// Connections at the same time. A page needs up to seven; each is a descriptor of the process that moves the machine.
const MAX_CONNECTIONS: usize = 256;
/// How long the beginning of a connection, and of a request, may take.
const BEGINNING: Duration = Duration::from_secs(10);

/// Serves connections for ever.
pub(crate) async fn listen(
    listener: TcpListener,
    router: Router,
    encryption: Option<TlsAcceptor>,
) -> Infallible {
    let places = Arc::new(Semaphore::new(MAX_CONNECTIONS));
    loop {
        // Closed never; who finds no place waits in the kernel's queue.
        let place = Arc::clone(&places).acquire_owned().await;
        let stream = match listener.accept().await {
            Ok((stream, _)) => stream,
            Err(_) => {
                // No descriptors: others end soon.
                tokio::time::sleep(Duration::from_millis(50)).await;
                continue;
            }
        };
        let (router, encryption) = (router.clone(), encryption.clone());
        tokio::spawn(async move {
            serve(stream, router, encryption).await;
            drop(place);
        });
    }
}

async fn serve(stream: TcpStream, router: Router, encryption: Option<TlsAcceptor>) {
    // A command is small and shall leave at once.
    let _delayed = stream.set_nodelay(true);
    match encryption {
        None => answer(stream, router).await,
        Some(acceptor) => {
            if let Ok(Ok(encrypted)) = tokio::time::timeout(BEGINNING, acceptor.accept(stream)).await {
                answer(encrypted, router).await;
            }
        }
    }
}

async fn answer(stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static, router: Router) {
    let service = TowerToHyperService::new(router);
    // What ends a connection is its client's affair.
    let _ended = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(BEGINNING)
        .max_buf_size(64 << 10)
        .serve_connection(TokioIo::new(stream), service)
        .with_upgrades()
        .await;
}
