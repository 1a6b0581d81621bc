// This file is written by the test of the generated types.

/** Alarms that are in force until they are cleared or a job starts. */
export type AlarmNumber = 100 | 101 | 102 | 103 | 200 | 201 | 202 | 203 | 300 | 400 | 401 | 402 | 403 | 404 | 405 | 406 | 407 | 408 | 409 | 410 | 411 | 412 | 413 | 414 | 415 | 416 | 417 | 418 | 420 | 421 | 422 | 423 | 430 | 440 | 500 | 501 | 600 | 601 | 602;
