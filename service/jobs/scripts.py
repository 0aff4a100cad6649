"""The atomic changes of a record, as Redis runs them.

KEYS[1] record, KEYS[2] its stream of events. Every change: check what the caller expects, then
write the fields, move the id between the per-state indexes, append an event, wake the waiters.
"""

from __future__ import annotations

# KEYS[3] owner's index, KEYS[4] the owner's idempotency key, KEYS[5] owner's live jobs
# ARGV: id, fields (JSON object), index prefix, feed channel, events kept, queue cap (0: none),
#       retention ms, digest of the request ("": it has no idempotency key), idempotency ms,
#       live jobs of an owner (0: no cap), key of the queue that it waits in
CREATE = """
if redis.call('EXISTS', KEYS[1]) == 1 then return {'exists'} end
if ARGV[8] ~= '' then
  local before = redis.call('HMGET', KEYS[4], 'digest', 'job')
  if before[1] then
    if before[1] == ARGV[8] then return {'repeated', before[2]} end
    return {'conflict', before[2]}
  end
end
local cap = tonumber(ARGV[6])
if cap > 0 and redis.call('ZCARD', ARGV[3] .. 'queued') >= cap then return {'full'} end
local most = tonumber(ARGV[10])
if most > 0 and redis.call('ZCARD', KEYS[5]) >= most then return {'quota'} end
local t = redis.call('TIME')
local ms = t[1] * 1000 + math.floor(t[2] / 1000)
local now = string.format('%d', ms)
for name, value in pairs(cjson.decode(ARGV[2])) do redis.call('HSET', KEYS[1], name, value) end
redis.call('HSET', KEYS[1], 'created_at', now, 'updated_at', now, 'queued_at', now,
           'expires_at', string.format('%d', ms + tonumber(ARGV[7])))
redis.call('ZADD', ARGV[3] .. 'queued', now, ARGV[1])
redis.call('ZADD', ARGV[11], now, ARGV[1])
redis.call('ZADD', KEYS[3], now, ARGV[1])
redis.call('ZADD', KEYS[5], now, ARGV[1])
redis.call('XADD', KEYS[2], 'MAXLEN', '~', ARGV[5], '*', 'event', 'state', 'data',
           '{"state": "queued"}')
if ARGV[8] ~= '' then
  redis.call('HSET', KEYS[4], 'digest', ARGV[8], 'job', ARGV[1])
  redis.call('PEXPIRE', KEYS[4], ARGV[9])
end
redis.call('PUBLISH', ARGV[4], ARGV[1] .. ' queued')
return {'ok', ARGV[1]}
"""

# ARGV: id, expected fields (JSON), states it may be in (",a,b,"), new state ("": stays),
#       fields (JSON), stamp field ("": none), 1 if the attempt number grows, event name ("": none),
#       event data, index prefix, feed channel, events kept, retention ms (0: not an end),
#       prefix of the owners' live jobs, key of the counts, key of webhooks that are due,
#       prefix of the owners' running jobs, cap on these (0: none), key of the parked jobs,
#       prefix of the queues
#
# A tile is in no index of its owner, counts for nothing there, and does not expire: it goes with
# its parent. A job that was split keeps its place among those that run, also while it waits to be
# joined, and then stands in its queue where it stood at first.
CHANGE = """
local state = redis.call('HGET', KEYS[1], 'state')
if not state then return {'missing'} end
for name, value in pairs(cjson.decode(ARGV[2])) do
  if (redis.call('HGET', KEYS[1], name) or '') ~= value then return {'fenced', state, name} end
end
if not string.find(ARGV[3], ',' .. state .. ',', 1, true) then return {'illegal', state} end
local running = ARGV[17] .. (redis.call('HGET', KEYS[1], 'owner') or '')
local most = tonumber(ARGV[18])
local tile = redis.call('HGET', KEYS[1], 'kind') == 'tile'
if ARGV[4] == 'running' and most > 0 and not tile
    and redis.call('SISMEMBER', running, ARGV[1]) == 0
    and redis.call('SCARD', running) >= most then
  redis.call('SADD', ARGV[19], ARGV[1])
  return {'waiting', state}
end
local t = redis.call('TIME')
local ms = t[1] * 1000 + math.floor(t[2] / 1000)
local now = string.format('%d', ms)
for name, value in pairs(cjson.decode(ARGV[5])) do redis.call('HSET', KEYS[1], name, value) end
redis.call('HSET', KEYS[1], 'updated_at', now)
if ARGV[6] ~= '' then redis.call('HSET', KEYS[1], ARGV[6], now) end
if ARGV[7] == '1' then redis.call('HINCRBY', KEYS[1], 'attempt', 1) end
if ARGV[4] ~= '' and ARGV[4] ~= state then
  redis.call('HSET', KEYS[1], 'state', ARGV[4])
  redis.call('ZREM', ARGV[10] .. state, ARGV[1])
  redis.call('ZADD', ARGV[10] .. ARGV[4], now, ARGV[1])
  local split = (redis.call('HGET', KEYS[1], 'split') or '0') ~= '0'
  local counts = ARGV[4] == 'running' or (ARGV[4] == 'queued' and split)
  if not tile then redis.call(counts and 'SADD' or 'SREM', running, ARGV[1]) end
  local queue = ARGV[20] .. (redis.call('HGET', KEYS[1], 'queue') or '')
  redis.call('ZREM', queue, ARGV[1])
  if ARGV[4] == 'queued' then
    local since = split and redis.call('HGET', KEYS[1], 'created_at') or now
    redis.call('ZADD', queue, since, ARGV[1])
  end
  state = ARGV[4]
end
local started = redis.call('HGET', KEYS[1], 'started_at')
if ARGV[13] ~= '0' and started then
  redis.call('HINCRBY', ARGV[15], 'run_milliseconds', ms - tonumber(started))
end
if ARGV[13] ~= '0' and not tile then
  local expiry = string.format('%d', ms + tonumber(ARGV[13]))
  redis.call('HSET', KEYS[1], 'expires_at', expiry)
  redis.call('ZADD', ARGV[10] .. 'ended', expiry, ARGV[1])
  local problem = cjson.decode(ARGV[5])['problem']
  local code = problem and cjson.decode(problem)['code'] or ''
  redis.call('HINCRBY', ARGV[15], ARGV[4] .. ' ' .. code, 1)
  redis.call('ZREM', ARGV[14] .. (redis.call('HGET', KEYS[1], 'owner') or ''), ARGV[1])
end
if state == 'expired' then redis.call('ZREM', ARGV[10] .. 'ended', ARGV[1]) end
if ARGV[8] ~= '' then
  local event = redis.call('XADD', KEYS[2], 'MAXLEN', '~', ARGV[12], '*',
                           'event', ARGV[8], 'data', ARGV[9])
  if ARGV[8] == 'state' and redis.call('HEXISTS', KEYS[1], 'webhook') == 1 then
    redis.call('ZADD', ARGV[16], ms, ARGV[1] .. ' ' .. event)
  end
  redis.call('PUBLISH', ARGV[11], ARGV[1] .. ' ' .. state)
end
return {'ok', state, redis.call('HGET', KEYS[1], 'attempt'),
        redis.call('HGET', KEYS[1], 'cancel') or ''}
"""

# ARGV: id, lease. Renewing says nothing to anyone: it only keeps the number of beats moving.
RENEW = """
if redis.call('HGET', KEYS[1], 'state') ~= 'running' then return {'ended'} end
if redis.call('HGET', KEYS[1], 'lease') ~= ARGV[2] then return {'fenced'} end
redis.call('HINCRBY', KEYS[1], 'beats', 1)
return {'ok', redis.call('HGET', KEYS[1], 'cancel') or ''}
"""

# KEYS[3] owner's index, KEYS[4] owner's live jobs, KEYS[5] log of webhooks,
# KEYS[6] owner's running jobs, KEYS[7] parked jobs, KEYS[8] the queue that it waits in
# ARGV: id, index prefix, feed channel
REMOVE = """
if redis.call('EXISTS', KEYS[1]) == 0 then return {'missing'} end
for _, state in ipairs({'queued', 'running', 'succeeded', 'failed', 'cancelled', 'expired',
                        'ended'}) do redis.call('ZREM', ARGV[2] .. state, ARGV[1]) end
redis.call('ZREM', KEYS[3], ARGV[1])
redis.call('ZREM', KEYS[4], ARGV[1])
redis.call('SREM', KEYS[6], ARGV[1])
redis.call('SREM', KEYS[7], ARGV[1])
redis.call('ZREM', KEYS[8], ARGV[1])
redis.call('DEL', KEYS[1], KEYS[2], KEYS[5])
redis.call('PUBLISH', ARGV[3], ARGV[1] .. ' removed')
return {'ok'}
"""
