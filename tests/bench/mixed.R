# Fits every model of jobs.json with lme4 and lmerTest; called by mixed.py, which compares.
suppressMessages({library(lme4); library(lmerTest); library(jsonlite)})
folder <- commandArgs(trailingOnly = TRUE)[1]
jobs <- fromJSON(file.path(folder, "jobs.json"))
fit <- function(job) {
  data <- read.csv(file.path(folder, job$file))
  start <- sum(proc.time()[1:2])
  model <- suppressWarnings(suppressMessages(lmerTest::lmer(as.formula(job$formula), data)))
  table <- suppressWarnings(coef(summary(model)))
  list(seconds = sum(proc.time()[1:2]) - start, criterion = REMLcrit(model), singular = isSingular(model),
       se = unname(table[, "Std. Error"]), df = unname(table[, "df"]))
}
invisible(fit(jobs[1, ]))
results <- lapply(seq_len(nrow(jobs)), function(row) fit(jobs[row, ]))
write_json(results, file.path(folder, "results.json"), digits = NA, auto_unbox = TRUE)
